"""Files of the F450 of JSBSim as one flight needs them, and the simulator that has read them.

Taken from the package: propellers, motors, metrics, the places of the rotors. Changed, so that a
vehicle file can describe the aircraft:

- coefficients of the propellers keep their value at standstill, unless inflow is hidden; then the
  coefficients of the package come in, continued on a straight line for descent;
- drag is linear in the speed along each body axis (the package has one CD of 1);
- no flight controller, sensors and landing gear of its own; a planet that is round and still.

Forces and moments from outside come in by `external_reactions`.
"""

import os
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .own.parameters import GRAVITY_M_S2, Array

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
