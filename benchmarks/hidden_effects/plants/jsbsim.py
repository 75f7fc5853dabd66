"""The F450 of JSBSim (PyPI): its motors, propellers and rigid body, integrated by itself.

Files of the F450 of JSBSim as one flight needs them, and the simulator that has read them.

Taken from the package: propellers, motors, metrics, the places of the rotors. Changed, so that a
vehicle file can describe the aircraft:

- coefficients of the propellers keep their value at standstill, unless inflow is hidden; then the
  coefficients of the package come in, continued on a straight line for descent;
- drag is linear in the speed along each body axis (the package has one CD of 1);
- no flight controller, sensors and landing gear of its own; a planet that is round and still.

Forces and moments from outside come in by `external_reactions`.

Our controller gives the throttles, our sensors read its state. Mass, inertia, rotor hubs and
inflow are hidden in its own files, wind in its atmosphere. Other forces and
moments come in from outside: those of our own plant with the hidden numbers, at the rotor speeds
and velocities of JSBSim, less those without them.

What its vehicle file says of the rotors is measured in JSBSim: static thrust and torque, speed by
throttle, time constant of a small step about hover. Reaction to the rotors' acceleration and
their gyroscopic moment are part of JSBSim and known to the file.
"""

import os
import re
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from .aircraft import Aircraft
from .own.parameters import GRAVITY_M_S2, STEP_S, Array, Batch, Parameters, stack
from .own.physics import (
    Dynamics,
    Instant,
    Layout,
    climb_slope,
    induced_velocity,
    own_dynamics,
    pad_forces,
)

NEWTON, METRE = 1 / 4.4482216152605, 1 / 0.3048
"""In lbf and ft."""
SECANT = 8
"""Row of the tables up to which they are taken as straight: advance ratio 0.2."""
_PLANET_M = 6371000.0
_ORIGIN = "<x>0</x><y>0</y><z>0</z></location>"
_AIRCRAFT = """<?xml version="1.0"?>
<fdm_config name="F450" version="2.0" release="ALPHA"><fileheader/>
<metrics file="Metrics.xml"/><mass_balance>{mass}</mass_balance><ground_reactions/>
<external_reactions>{external}</external_reactions><propulsion file="Propulsion.xml"/>
<aerodynamics>{drag}</aerodynamics></fdm_config>
"""
_PLANET = f"""<?xml version="1.0"?>
<planet name="still"><semimajor_axis unit="M">{_PLANET_M}</semimajor_axis>
<semiminor_axis unit="M">{_PLANET_M}</semiminor_axis><rotation_rate unit="RAD/SEC">0</rotation_rate>
<GM unit="M3/SEC2">{GRAVITY_M_S2 * _PLANET_M**2}</GM><J2>0</J2></planet>
"""


@cache
def package_file(name: str) -> str:
    """Text of a file of the package; it is not imported for that."""
    found = find_spec("jsbsim")
    assert found is not None and found.origin is not None
    return (Path(found.origin).parent / name).read_text("utf-8")


def numbers(text: str, tag: str) -> list[float]:
    """Content of every element of this name."""
    return [float(m) for m in re.findall(rf"<{tag}\b[^>]*>\s*([-+.\de]+)\s*<", text)]


def rows(text: str, name: str) -> list[tuple[float, float]]:
    """A table of the propeller: advance ratio, coefficient."""
    content = re.search(rf'name="{name}".*?<tableData>(.*?)</tableData>', text, re.DOTALL)
    assert content is not None
    return [(float(a), float(b)) for a, b in re.findall(r"(\S+)[ \t]+(\S+)", content[1])]


def simulator(
    mass: float, inertia: Array, hubs: Array, drag: Array, inflow: float, step_s: float
) -> Any:
    """JSBSim with the F450 at rest, motors running.

    Args:
        mass: kg.
        inertia: Diagonal, kg m2.
        hubs: From the centre of mass, body FRD, m, shape (4, 3).
        drag: By body axis, N s/m.
        inflow: Share of the dependence of the package's propeller on the advance ratio.
        step_s: Of its integration.
    """
    os.environ["JSBSIM_DEBUG"] = "0"  # it prints to stdout
    import jsbsim

    logger = jsbsim.DefaultLogger()
    logger.set_min_level(jsbsim.LogLevel.ERROR)
    jsbsim.set_logger(logger)

    with TemporaryDirectory() as folder:
        root, place = Path(folder), Path(folder) / "aircraft/F450"
        for directory in (place, root / "engine", root / "systems"):
            directory.mkdir(parents=True)
        (place / "F450.xml").write_text(_aircraft(mass, inertia, drag), "utf-8")
        (place / "Metrics.xml").write_text(package_file("aircraft/F450/Metrics.xml"), "utf-8")
        (place / "Propulsion.xml").write_text(_propulsion(hubs), "utf-8")
        (root / "engine/DJI_E305.xml").write_text(package_file("engine/DJI_E305.xml"), "utf-8")
        (root / "engine/DJI_9450.xml").write_text(_propeller(inflow), "utf-8")
        (root / "planet.xml").write_text(_PLANET, "utf-8")
        fdm = jsbsim.FGFDMExec(folder)
        fdm.set_debug_level(0)
        assert fdm.load_planet(str(root / "planet.xml"), False)
        assert fdm.load_model("F450")
    fdm.set_dt(step_s)
    fdm["ic/h-sl-ft"], fdm["ic/terrain-elevation-ft"] = 0.0, -1000.0
    assert fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    return fdm


def _aircraft(mass: float, inertia: Array, drag: Array) -> str:
    body = f'<emptywt unit="KG">{float(mass)!r}</emptywt><location name="CG" unit="M">{_ORIGIN}'
    body += "".join(
        f'<i{a}{a} unit="KG*M2">{float(v)!r}</i{a}{a}>' for a, v in zip("xyz", inertia, strict=True)
    )
    external = ""
    for kind, letter in (("force", "f"), ("moment", "m")):
        for axis in "xyz":
            along = "".join(f"<{a}>{int(a == axis)}</{a}>" for a in "xyz")
            external += f'<{kind} name="{letter}{axis}" frame="BODY"><direction>{along}</direction>'
            if kind == "force":
                external += f'<location unit="M">{_ORIGIN}'
            external += f"</{kind}>"
    air = "".join(
        f'<axis name="{axis}"><function name="drag{axis}"><product>'
        f"<value>{-float(c) * NEWTON / METRE!r}</value>"
        f"<property>velocities/{speed}-aero-fps</property></product></function></axis>"
        for axis, speed, c in zip("XYZ", "uvw", drag, strict=True)
    )
    return _AIRCRAFT.format(mass=body, external=external, drag=air)


def _propulsion(hubs: Array) -> str:
    """The package's, rotors at other places; axes there point aft, right, up."""
    text = package_file("aircraft/F450/Propulsion.xml")
    places = iter(hubs * [-1.0, 1.0, -1.0])

    def place(_: re.Match[str]) -> str:
        x, y, z = next(places)
        return f'<location unit="M"><x>{x}</x><y>{y}</y><z>{z}</z></location>'

    return re.sub(r'<location unit="M">.*?</location>', place, text, flags=re.DOTALL)


def _propeller(inflow: float) -> str:
    """The package's, with a share of its dependence on the advance ratio."""
    text = package_file("engine/DJI_9450.xml")
    for name in ("C_THRUST", "C_POWER"):
        table = rows(text, name)
        still, slope = table[0][1], (table[SECANT][1] - table[0][1]) / table[SECANT][0]
        table = [(-0.3, still - 0.3 * slope), *table]
        blended = "\n".join(f"{j} {still + inflow * (c - still)}" for j, c in table)
        text = re.sub(
            rf'(name="{name}".*?<tableData>).*?(</tableData>)',
            rf"\g<1>\n{blended}\n\g<2>",
            text,
            flags=re.DOTALL,
        )
    return text


RPM = 30 / np.pi
_ROTORS, _MAP_ORDER = 4, 4
_DRAG = np.array([0.28, 0.28, 0.36])
_HEAVY_KG = 1e6
"""Mass of an aircraft that stays where it is."""
_SLOWEST_RAD_S = 1.0
"""Of a rotor as the laws of our own plant see it; some divide by the speed."""
_SPEEDS = [f"propulsion/engine[{i}]/propeller-rpm" for i in range(_ROTORS)]
_THROTTLES = [f"fcs/throttle-cmd-norm[{i}]" for i in range(_ROTORS)]
_POSITION = [f"position/from-start-neu-{a}-ft" for a in "neu"]
_VELOCITY = [f"velocities/v-{a}-fps" for a in ("north", "east", "down")]
_ANGLES = [f"attitude/{a}-rad" for a in ("phi", "theta", "psi")]
_RATES = [f"velocities/{a}-rad_sec" for a in "pqr"]
_FORCES = [f"forces/fb{a}-total-lbs" for a in "xyz"]
_TURNS = [f"accelerations/{a}dot-rad_sec2" for a in "pqr"]
_WIND = [f"atmosphere/wind-{a}-fps" for a in ("north", "east", "down")]
_PUSH = [f"external_reactions/f{a}/magnitude" for a in "xyz"]
_TWIST = [f"external_reactions/m{a}/magnitude-lbsft" for a in "xyz"]


@cache
def f450() -> Aircraft:
    """The aircraft as a nominal plant, its rotors measured at rest."""
    mass_file = package_file("aircraft/F450/Mass.xml")
    propulsion, propeller = (
        package_file(f) for f in ("aircraft/F450/Propulsion.xml", "engine/DJI_9450.xml")
    )
    mass = numbers(mass_file, "emptywt")[0]
    inertia = np.array([numbers(mass_file, f"i{a}{a}")[0] for a in "xyz"])
    x, y, z = (np.array(numbers(propulsion, a)) for a in "xyz")
    sense = np.array(numbers(propulsion, "sense"))
    hubs, direction = np.stack([-x, y, -z], axis=1), -sense
    bench = _Bench(hubs, inertia)
    throttle = np.linspace(0.15, 1.0, 18)
    speed, thrust, torque = np.array([bench.settled(float(c)) for c in throttle]).T
    thrust_k, torque_k = float(np.mean(thrust / speed**2)), float(np.mean(torque / speed**2))
    hover = float(np.sqrt(mass * GRAVITY_M_S2 / (_ROTORS * thrust_k)))
    by_throttle = Polynomial.fit(throttle, speed, _MAP_ORDER).convert()
    at = float(np.interp(hover, speed, throttle))
    slope = float(by_throttle.deriv()(at))
    nominal = Parameters(
        mass=mass,
        inertia=inertia,
        hubs=hubs,
        direction=direction,
        thrust_k=np.full(_ROTORS, thrust_k),
        torque_k=np.full(_ROTORS, torque_k),
        speed_0=hover - slope * at,
        speed_1=slope,
        lag=bench.lag(at),
        hover_speed=hover,
        radius=numbers(propeller, "diameter")[0] * 0.0254 / 2,
        leg=0.15,
        drag_linear=_DRAG,
        drag_quadratic=np.zeros(3),
        accel_cutoff_hz=60.0,
        spin_inertia_yaw=numbers(propeller, "ixx")[0],
        spin_inertia_gyro=numbers(propeller, "ixx")[0],
    )
    return Aircraft(
        "F450",
        nominal,
        by_command=False,
        pace=1.0,
        spin_inertia=nominal.spin_inertia_yaw,
        speed_of_command=tuple(by_throttle.coef.tolist()),
        known=("rotor_inertia_torque", "gyroscopic_torque"),
    )


def f450_dynamics() -> Dynamics:
    """A new simulation."""
    return JsbsimFlights()


class JsbsimFlights:
    """One JSBSim per flight of a batch; a `Simulator`."""

    def __init__(self) -> None:
        self._fdms: list[Any] = []

    def begin(self, batch: Batch, start: Array) -> None:
        """Load the aircraft of the flights, at rest at these positions."""
        p, nominal = batch.p, f450().nominal
        same = stack([nominal] * batch.n)
        self._hidden = _like(batch, p, inflow_gain=np.zeros(batch.n))
        self._base = _like(batch, same, mass=p.mass, inertia=p.inertia, hubs=p.hubs)
        mass = np.asarray(p.mass)
        slope = np.asarray(climb_slope(p.inflow_gain, _induced(nominal)))
        self._fdms = [
            simulator(
                float(mass[i]),
                p.inertia[:, i],
                p.hubs[:, :, i],
                _DRAG,
                float(slope[i]) / _package_slope(nominal),
                STEP_S,
            )
            for i in range(batch.n)
        ]
        self._start = start
        self.hold(np.zeros((3, batch.n)))

    def __call__(self, batch: Batch, now: Instant) -> tuple[Array, Array]:
        """Force without weight and angular acceleration, body axes, as JSBSim has them now."""
        with_it, turning_with = own_dynamics(self._hidden, now)
        without, turning = own_dynamics(self._base, now)
        push, twist = pad_forces(batch, now.pos[2], now.vel, now.omega, now.r)
        self._push = with_it - without + push
        self._twist = batch.p.inertia * (turning_with - turning) + twist
        return self._read(_FORCES) / NEWTON, self._read(_TURNS)

    def step(self, layout: Layout, x: Array, command: Array, wind: Array) -> None:
        """One step of JSBSim; what it knows better is overwritten in the state."""
        self._write(_THROTTLES, command)
        self._write(_WIND, wind * METRE)
        self._write(_PUSH, self._push * NEWTON)
        self._write(_TWIST, self._twist * NEWTON * METRE)
        for fdm in self._fdms:
            fdm.run()
        x[layout.pos] = self._start + self._read(_POSITION) / METRE * [[1.0], [1.0], [-1.0]]
        x[layout.vel] = self._read(_VELOCITY) / METRE
        x[layout.q] = _quaternion(self._read(_ANGLES))
        x[layout.omega] = self._read(_RATES)
        x[layout.rotor] = np.maximum(self._read(_SPEEDS) / RPM, _SLOWEST_RAD_S)

    def hold(self, force: Array) -> None:
        """Push from outside, body axes, N, until the next call."""
        self._push, self._twist = force, np.zeros_like(force)

    def thrust(self) -> Array:
        """Of every rotor, N, shape (4, n)."""
        return self._read([f"propulsion/engine[{i}]/thrust-lbs" for i in range(_ROTORS)]) / NEWTON

    def _read(self, names: list[str]) -> Array:
        return np.array([[fdm[name] for fdm in self._fdms] for name in names])

    def _write(self, names: list[str], values: Array) -> None:
        for name, row in zip(names, values, strict=True):
            for fdm, value in zip(self._fdms, row.tolist(), strict=True):
                fdm[name] = value


class _Bench:
    """The aircraft made heavy and held, so that it stays where it is."""

    def __init__(self, hubs: Array, inertia: Array) -> None:
        self._fdm = simulator(_HEAVY_KG, _HEAVY_KG * inertia, hubs, 0 * _DRAG, 0.0, STEP_S)
        self._fdm[_PUSH[2]] = -_HEAVY_KG * GRAVITY_M_S2 * NEWTON

    def settled(self, throttle: float) -> tuple[float, float, float]:
        """Speed, thrust and torque of a rotor."""
        self._run(throttle, 2000)
        fdm = self._fdm
        thrust = fdm["propulsion/engine/thrust-lbs"] / NEWTON
        torque = -fdm["propulsion/engine/propeller-torque-ftlb"] / NEWTON / METRE
        return fdm[_SPEEDS[0]] / RPM, thrust, torque

    def lag(self, throttle: float) -> float:
        """Time in which a small step of the throttle, up and down, is 63 % followed, s."""
        found = []
        for change in (0.02, -0.02):
            start, end = self.settled(throttle)[0], self.settled(throttle + change)[0]
            self._run(throttle, 2000)
            steps = 0
            while (self._fdm[_SPEEDS[0]] / RPM - start) / (end - start) < 1 - np.exp(-1):
                self._run(throttle + change, 1)
                steps += 1
            found.append(steps * STEP_S)
        return float(np.mean(found))

    def _run(self, throttle: float, steps: int) -> None:
        for name in _THROTTLES:
            self._fdm[name] = throttle
        for _ in range(steps):
            self._fdm.run()


def _induced(nominal: Parameters) -> float:
    """Induced velocity of hover, m/s."""
    return float(np.mean(induced_velocity(nominal.hover_thrust, np.asarray(nominal.radius))))


def _package_slope(nominal: Parameters) -> float:
    """Share of the thrust of the package's propeller lost per climb speed about hover, s/m."""
    table = rows(package_file("engine/DJI_9450.xml"), "C_THRUST")
    per_ratio = (table[0][1] - table[SECANT][1]) / (table[SECANT][0] * table[0][1])
    turns = nominal.hover_speed / (2 * np.pi)
    return float(per_ratio / (turns * 2 * nominal.radius))


def _like(batch: Batch, p: Parameters, **numbers: Any) -> Batch:
    """A batch of as many flights with other numbers."""
    other = Batch.__new__(Batch)
    other.p, other.n, other.rotors = replace(p, **numbers), batch.n, batch.rotors
    return other


def _quaternion(angles: Array) -> Array:
    """Body to NED from roll, pitch and yaw."""
    c, s = np.cos(0.5 * angles), np.sin(0.5 * angles)
    (cr, cp, cy), (sr, sp, sy) = c, s
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
