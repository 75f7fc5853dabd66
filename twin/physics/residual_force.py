"""Residual force and moment of the equations, as a law of the motion learned from flights.

    [force, moment] = units * bound(near(d) * (linear @ features(x) + module(x)))
    z = (x - centre) / scale           d = |whitening @ z| / sqrt(len(z)) / reach

x is the motion relative to air and rotors (`INPUTS`): without gravity, heading or position, so that
the law is valid on every mission. Up to d = 1 it is within the training flights; from there `near`
decreases smoothly to zero at `FADED`; and each output stays within `most`. So force and moment are
bounded for any motion. A law is evaluated every `PERIOD_S` and held in between.

In addition to the law, an unpredictable part can be drawn: a random force and moment, off by
default, whose spectrum is a level in each third-octave. Each is white noise through a band-pass of
two poles and a zero at frequency 0, sampled:

    a' = 2 r cos(w T sqrt(1 - 1/4Q^2)) a - r^2 b + n     b' = a     r = exp(-w T / 2Q)

and a - b is the noise, scaled by its standard deviation.

Source: the fade, Perlin's smoothstep; the band-pass, Oppenheim & Schafer, Discrete-Time Signal
Processing, sec. 5.3.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component, ComponentBuilder
from ..errors import ModelError
from ..frames import AXES, to_body
from ..representation import ShortRepr
from ..vehicle import Vehicle

Array = NDArray[np.float64]
INPUTS = (
    *((f"air_{a}", "m/s") for a in AXES),
    *((f"omega_{a}", "rad/s") for a in AXES),
    ("thrust", "1"),
    ("roll", "1"),
    ("pitch", "1"),
    ("yaw", "1"),
    ("voltage", "1"),
    ("ground", "1"),
)
"""Physical inputs: velocity through the air and body rates, body FRD; squared rotor speed relative
to hover, its mean less one and its combinations that give moments about each axis; voltage over
nominal less one; nearness to the ground, 1 / (1 + (height / arm)^2)."""
OUTPUTS = (*(("force", a) for a in AXES), *(("moment", a) for a in AXES))
"""Components of the learned wrench, body FRD."""
FEATURES = (
    "one",
    *(name for name, _ in INPUTS),
    *(f"thrust air_{a}" for a in AXES),
    *(f"speed air_{a}" for a in AXES),
    "thrust thrust",
    *(f"omega omega_{a}" for a in AXES),
)
"""Features of the linear part: a constant, the inputs, and products with a physical meaning: drag
of rotors and of the body, a curved thrust map, gyroscopic moments."""
FADED = 2.0
"""Distance, relative to the reach of the training, at which a law has decreased to zero, as for a
network of the sensors. Not chosen on flights."""


NOISE_HZ = tuple((0.2 * 2 ** (np.arange(24) / 3)).tolist())
"""Centre frequency of each third-octave of the noise, Hz: from what a hover of some seconds
resolves to the bandwidth of logs."""
PERIOD_S = 2e-3
"""Time between two evaluations of the law and draws of the noise, s. With 5 ms errors of attitude
and rates grow by up to 6 and 8 % (RflySimDT, real_2, after 0.05 s), with 2 ms by 1 and 2 %."""
_LARGEST = 1e12
"""Magnitude to which a module is bounded before it fades, m/s2 and rad/s2: above any `most`."""
_BANDS = (len(OUTPUTS), len(NOISE_HZ))  # shape of the noise


@dataclass(frozen=True, slots=True)
class ForceLaw(ShortRepr):
    """Numbers of a law.

    Attributes:
        linear: Specific force, m/s2, and angular acceleration, rad/s2, per feature, shape
            (6, len(FEATURES)).
        centre: Centre of the inputs, shape (len(INPUTS),).
        scale: Scale of the inputs, above 0, shape (len(INPUTS),).
        whitening: Matrix that decorrelates z, shape (len(INPUTS), len(INPUTS)).
        reach: Largest distance in the training, above 0.
        most: Bound of the magnitude of specific force, m/s2, and angular acceleration, rad/s2, at
            least 0, shape (6,).
        units: Force, N, and moment, N m, per specific force and angular acceleration, shape (6, 6).
        noise: Standard deviation of the noise in each band of `NOISE_HZ`, m/s2 and rad/s2, at least
            0, shape (6, len(NOISE_HZ)).
        module: Addition to the linear part, as a function of `INPUTS`; None: none.
    """

    linear: Array
    centre: Array
    scale: Array
    whitening: Array
    reach: float
    most: Array
    units: Array
    noise: Array = field(default_factory=lambda: np.zeros(_BANDS))
    module: ca.Function | None = None

    def __post_init__(self) -> None:
        """Raise ModelError where shapes or numbers are invalid."""
        d = len(INPUTS)
        shapes = {
            "linear": (6, len(FEATURES)),
            "centre": (d,),
            "scale": (d,),
            "whitening": (d, d),
            "most": (6,),
            "units": (6, 6),
            "noise": _BANDS,
        }
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape:
                raise ModelError(f"force law: {name} has shape {values.shape}, not {shape}.")
            if not np.isfinite(values).all():
                raise ModelError(f"force law: {name} must be finite numbers.")
        if not (self.scale > 0).all() or not 0 < self.reach < np.inf:
            raise ModelError("force law: scale and reach must be above 0.")
        if not (self.most >= 0).all() or not (self.noise >= 0).all():
            raise ModelError("force law: most and noise must be at least 0.")

    def arrays(self) -> dict[str, Array]:
        """All its numbers by name."""
        return {n: np.asarray(getattr(self, n), dtype=np.float64) for n in _ARRAYS}

    @classmethod
    def of(cls, arrays: Mapping[str, Array]) -> "ForceLaw":
        """The law with these numbers.

        Raises:
            ModelError: Some are missing, of another shape or not finite.
        """
        if set(arrays) != set(_ARRAYS):
            raise ModelError(f"force law: has {sorted(arrays)}, not {sorted(_ARRAYS)}.")
        return cls(**{k: v if k != "reach" else float(v) for k, v in arrays.items()})  # type: ignore[arg-type]


_ARRAYS = tuple(f.name for f in fields(ForceLaw) if f.name != "module")


def motion_inputs(
    vehicle: Vehicle,
    air_b: Sequence[ca.SX],
    omega_b: Sequence[ca.SX],
    spin: Sequence[ca.SX],
    voltage: ca.SX,
    height: ca.SX,
) -> ca.SX:
    """`INPUTS` as expressions, shape (len(INPUTS), 1).

    Args:
        vehicle: Vehicle with positions and directions of its rotors.
        air_b: Velocity through the air, body FRD, m/s.
        omega_b: Body rates, rad/s.
        spin: Rotor speeds relative to hover.
        voltage: Battery voltage, V.
        height: Height of the centre of mass over the ground, m.
    """
    n, arm = len(spin), vehicle.arm_m
    square = [s * s for s in spin]
    hubs, turns = vehicle.rotors.position_m, vehicle.rotors.direction
    weights = {
        "roll": -hubs[:, 1] / arm,
        "pitch": hubs[:, 0] / arm,
        "yaw": -np.asarray(turns),
    }
    parts = [
        sum((float(w) * s for w, s in zip(row, square, strict=True)), start=ca.SX(0)) / n
        for row in weights.values()
    ]
    mean = sum(square, start=ca.SX(0)) / n - 1
    near = nearness(height, arm)
    return ca.vertcat(*air_b, *omega_b, mean, *parts, voltage / vehicle.voltage_v - 1, near)


def nearness(height: ca.SX, arm_m: float) -> ca.SX:
    """Nearness to the ground: 1 on it, falling with the square of the height in arms."""
    return 1 / (1 + (height / arm_m) ** 2)


def features(x: ca.SX) -> ca.SX:
    """`FEATURES` of inputs, shape (len(FEATURES), 1)."""
    air, omega, mean = [x[i] for i in range(3)], [x[i] for i in range(3, 6)], x[6]
    # Bounded below: the root has no derivative at rest.
    speed = ca.sqrt(ca.fmax(sum((v * v for v in air), start=ca.SX(0)), 1e-30))
    gyroscopic = [omega[1] * omega[2], omega[0] * omega[2], omega[0] * omega[1]]
    products = [*(mean * v for v in air), *(speed * v for v in air), mean * mean, *gyroscopic]
    return ca.vertcat(1, x, *products)


def distance(law: ForceLaw, x: ca.SX) -> ca.SX:
    """Distance of inputs from those of the training, 1 at their limit."""
    whole = law.whitening / law.scale / (law.reach * np.sqrt(len(INPUTS)))
    # Bounded below: the root has no derivative at the centre of the training.
    return ca.sqrt(ca.fmax(ca.sumsqr(ca.mtimes(ca.SX(whole), x - law.centre)), 1e-30))


def accelerations(law: ForceLaw, x: ca.SX, linear: ca.SX) -> ca.SX:
    """Specific force, m/s2, and angular acceleration, rad/s2, of a law before they are bounded,
    shape (6, 1).

    Args:
        law: Law with the envelope.
        x: Values of `INPUTS`.
        linear: Weights in place of those of the law.
    """
    d = distance(law, x)
    said = ca.mtimes(linear, features(x))
    if law.module is not None:
        # Finite before it fades, as zero times infinity is no number.
        said = said + ca.fmin(ca.fmax(law.module(x), -_LARGEST), _LARGEST)
    return _fade(d) * said


def parameter_values(law: ForceLaw) -> dict[str, float]:
    """Parameters of the component for another law with the same envelope."""
    linear, most = _parameter_names()
    names = [*(n for row in linear for n in row), *most]
    values = np.concatenate([law.linear.ravel(), law.most])
    return dict(zip(names, values.tolist(), strict=True))


def _parameter_names() -> tuple[list[list[str]], list[str]]:
    """Parameters of the component: linear weights, and bounds."""
    outputs = [f"{kind}_{a}" for kind, a in OUTPUTS]
    linear = [[f"linear.{o}.{f.replace(' ', '_')}" for f in FEATURES] for o in outputs]
    return linear, [f"most.{o}" for o in outputs]


def residual_force(vehicle: Vehicle, law: ForceLaw) -> Component:
    """Component of the law: inputs from the airframe's outputs, outputs are force and moment.

    Its weights and bounds are tunable parameters (`parameter_values`), so that they can be
    inspected.

    Args:
        vehicle: Vehicle with the residual force.
        law: Learned law.
    """
    m = ComponentBuilder("residual_force", f"What the equations of {vehicle.name} leave, as taught")
    # In the order of the airframe's outputs: they are copied in one piece.
    down = m.input("pos_z", "m", "Position, NED down", -100.0)
    vel_n = [m.input(f"vel_{a}", "m/s", f"Velocity, NED {a}") for a in AXES]
    q_nb = [m.input(f"q_{a}", "1", f"Attitude, {a}", float(a == "w")) for a in "wxyz"]
    omega_b = [m.input(f"omega_{a}", "rad/s", f"Body rate about {a}") for a in AXES]
    spin = [
        m.input(f"spin_{i}", "1", f"Speed of rotor {i} over that in hover", 1.0)
        for i in range(1, vehicle.rotors.count + 1)
    ]
    voltage = m.input("voltage", "V", "Battery voltage at the motors", vehicle.voltage_v)
    wind_n = [m.input(f"wind_{a}", "m/s", f"Velocity of the air, NED {a}") for a in AXES]
    ground = m.parameter("ground.z", 0.0, "m", "Ground plane, NED down")
    enabled = m.parameter(
        "enabled", 1.0, "1", "Whether the law acts", kind="boolean", minimum=0, maximum=1
    )
    air_b = to_body(q_nb, [v - w for v, w in zip(vel_n, wind_n, strict=True)])
    x = motion_inputs(vehicle, air_b, omega_b, spin, voltage, ground - down)
    m.sampled(PERIOD_S, "Time between two evaluations, for which the bands of the noise are made")
    names, bounds = _parameter_names()
    linear = _weights(m, names, law.linear)
    most, now = _bounds(m, bounds, law.most), accelerations(law, x, linear)
    said = [_held(m, f"law.{kind}_{a}", _unit(kind), now[i]) for i, (kind, a) in enumerate(OUTPUTS)]
    # Bounded after they are held: choices among them keep a compiler from multiplying in vectors.
    within = ca.fmin(ca.fmax(ca.vertcat(*said), -most), most)
    acts = ca.mtimes(ca.SX(law.units), enabled * within + _noise(m, law.noise))
    for i, (kind, a) in enumerate(OUTPUTS):
        unit, meaning = ("N", "Force along") if kind == "force" else ("N.m", "Moment about")
        m.output(f"{kind}_{a}", unit, f"{meaning} body {a} that the equations lack", acts[i])
    d = _held(m, "distance.held", "1", distance(law, x))
    m.output("distance", "1", "Of the motion from that of the training, 1 where this ends", d)
    return m.build()


def _held(m: ComponentBuilder, name: str, unit: str, value: ca.SX) -> ca.SX:
    """A value of the last sample instant."""
    held = m.memory(name, unit, f"{name} at the last evaluation", value)
    m.update(name, value)
    return held


def noise_values(noise: Array) -> dict[str, float]:
    """Parameters of the component for another noise, by name."""
    names = _noise_names()
    return {names[i][k]: float(noise[i, k]) for i, k in np.ndindex(noise.shape)}


def _noise_names() -> list[list[str]]:
    """Parameters: the level in each third-octave."""
    return [[f"noise.{kind}_{a}.{k}" for k in range(1, _BANDS[1] + 1)] for kind, a in OUTPUTS]


def _noise(m: ComponentBuilder, levels: Array) -> ca.SX:
    """Random specific force and angular acceleration, shape (6, 1); components without a level are
    not built."""
    drawn, names = ca.SX.zeros(_BANDS[0]), _noise_names()
    if not levels.any():
        return drawn
    enabled = m.parameter(
        "noise.enabled", 0.0, "1", "Whether noise is drawn", kind="boolean", minimum=0, maximum=1
    )
    for i, k in np.argwhere(levels > 0).tolist():
        name, unit, what = names[i][k], _unit(OUTPUTS[i][0]), f"noise at {NOISE_HZ[k]:.3g} Hz"
        level = m.parameter(name, levels[i, k], unit, f"Standard deviation of {what}", minimum=0)
        one, two, size = _band(NOISE_HZ[k])
        a, b = (m.memory(f"{name}.{s}", "1", f"{what}, {s}") for s in ("now", "before"))
        m.update(f"{name}.now", enabled * (one * a - two * b + m.noise(enabled * size)))
        m.update(f"{name}.before", enabled * a)
        drawn[i] = drawn[i] + enabled * level * (a - b)
    off = enabled < 0.5
    m.idle_while(off, ca.SX.sym("step"), [enabled])
    return drawn


def _band(f_hz: float) -> tuple[float, float, float]:
    """Both coefficients of a third-octave's recursion, and the input noise for variance 1."""
    q = 1 / (2 ** (1 / 6) - 2 ** (-1 / 6))
    step = 2 * np.pi * f_hz * PERIOD_S
    r = np.exp(-step / (2 * q))
    one, two = 2 * r * np.cos(step * np.sqrt(1 - 1 / (4 * q * q))), r * r
    variance = (1 + two) / ((1 - two) * ((1 + two) ** 2 - one**2))
    return float(one), float(two), float(1 / np.sqrt(2 * variance * (1 - one / (1 + two))))


def _unit(kind: str) -> str:
    """Unit of the residual, per mass or inertia."""
    return "m/s2" if kind == "force" else "rad/s2"


def _weights(m: ComponentBuilder, names: list[list[str]], values: Array) -> ca.SX:
    """A matrix of parameters with the weights of a law as start values. Those of one feature follow
    each other, so that a compiler multiplies it by several of them at once."""
    weights = ca.SX(*values.shape)
    for k, i in np.ndindex(values.T.shape):
        name, kind = names[i][k], OUTPUTS[i][0]
        what = "Specific force" if kind == "force" else "Acceleration"
        meaning = f"{what} per {name.split('.', 2)[2]} in SI units"
        weights[i, k] = m.parameter(name, float(values[i, k]), _unit(kind), meaning)
    return weights


def _bounds(m: ComponentBuilder, names: Sequence[str], values: Array) -> ca.SX:
    """Parameters with the bounds of a law as start values, shape (6, 1)."""
    rows = zip(OUTPUTS, names, values.tolist(), strict=True)
    return ca.vertcat(
        *[
            m.parameter(name, most, _unit(kind), f"Most that is said of {kind} {a}", minimum=0)
            for (kind, a), name, most in rows
        ]
    )


def _fade(d: ca.SX) -> ca.SX:
    """1 up to a distance of 1, 0 from `FADED` on, a smooth cubic in between."""
    t = ca.fmin(ca.fmax((d - 1) / (FADED - 1), 0.0), 1.0)
    return 1 - t * t * (3 - 2 * t)
