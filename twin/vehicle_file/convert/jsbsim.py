"""A multirotor of JSBSim (aircraft XML with propellers) as a vehicle file.

The laws are those of its FGPropeller and of its aerodynamic functions;
`docs/reference/simulators.md` lists them. Its electric motors have no law in continuous time, so
the input of the vehicle is rotor speed.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import ModelError
from ...vehicle import Array
from ..write import Draft
from .common import Element, MassProperties, combined, floats, read_xml

SEA_LEVEL_KG_M3 = 1.225
"""Air density of a vehicle file's numbers; JSBSim's coefficients do not include density."""
_TO_SI = {
    "M": 1.0,
    "FT": 0.3048,
    "IN": 0.0254,
    "KG": 1.0,
    "LBS": 0.45359237,
    "KG*M2": 1.0,
    "SLUG*FT2": 1.3558179483314,
    "M2": 1.0,
    "FT2": 0.3048**2,
    "DEG": np.pi / 180,
    "RAD": 1.0,
}  # by definition of foot and pound (NIST SP 811)
_DYNAMIC_PRESSURE_AREA = "aero/qbar-area"  # property in JSBSim, lbf
_FORCES = ("LIFT", "SIDE", "ROLL", "PITCH", "YAW")  # axes besides DRAG
Terms = dict[tuple[str, ...], float]
"""A sum of products of properties: factor by the properties' names, sorted."""


@dataclass(frozen=True, slots=True)
class _Propeller:
    """A propeller file in SI units; tables with columns advance ratio and coefficient."""

    diameter_m: float
    inertia_kg_m2: float
    thrust: Array
    power: Array


def convert_jsbsim(path: Path) -> str:
    """Text of a vehicle file for an aircraft of JSBSim with propellers as thrusters.

    Raises:
        ModelError: A part of it has no equivalent in a vehicle file.
    """
    path = path.resolve()  # engine files are in folders next to that of the aircraft
    parts = _parts(path)
    body = _body(path.name, parts["mass_balance"])
    engines = parts["propulsion"].findall("engine")
    propeller, names = _one_propeller(path, engines)
    name = read_xml(path).get("name") or path.stem
    d = Draft(name, f"{name} of JSBSim", path.name)
    motors = sorted({str(e.get("file")) for e in engines})
    d.notes.append(
        f"Converted from {path.name} of JSBSim. Left out: the motors ({', '.join(motors)}), whose "
        f"speed follows the throttle by rules of its time step, so that this vehicle is known by "
        f"rotor speed; stiffness and damping of the ground contacts; flight control; sensors."
    )
    d.notes.append(
        "Differences of law: JSBSim takes the advance ratio at the centre of mass, this format at "
        "each hub."
    )
    d.number("body.mass", body.mass_kg, "kg", "<emptywt>")
    d.number("body.inertia", np.diag(body.inertia_kg_m2), "kg*m^2", "<ixx>, <iyy>, <izz>")
    drag = _drag(path.name, parts)
    if drag:
        d.number(
            "body.drag_parasitic",
            np.full(3, drag),
            "N*s^2/m^2",
            "<axis name=DRAG> over aero/qbar-area, times 0.5 * 1.225 kg/m^3 * <wingarea>",
        )
    lowest = _lowest_contact(path.name, parts.get("ground_reactions"))
    if lowest is not None and lowest > body.centre_m[2]:
        d.number("body.leg_height", lowest - body.centre_m[2], "m", "lowest <contact>")
    _describe_rotors(d, path.name, engines, body, propeller, ", ".join(names))
    return d.text()


def _describe_rotors(
    d: Draft, file: str, engines: list[Element], body: MassProperties, p: _Propeller, source: str
) -> None:
    thrusters = [e.find("thruster") for e in engines]
    hubs = np.stack([_location(file, t) for t in thrusters]) - body.centre_m
    d.number("rotors.position", hubs + 0.0, "m", "<location> of the thrusters, turned to FRD")
    senses = [float(floats(file, "<sense>", t.findtext("sense", "1"), 1)[0]) for t in thrusters]
    d.words(
        "rotors.direction",
        ["ccw" if s > 0 else "cw" for s in senses],
        "<sense>, seen from behind the thruster, which is from below",
    )
    thrust, power = (float(np.interp(0.0, *t.T)) for t in (p.thrust, p.power))
    if thrust <= 0 or power <= 0:
        raise ModelError(f"{file}: C_THRUST and C_POWER must be positive at rest.")
    turn = 2 * np.pi
    d.number(
        "rotors.thrust_from_speed",
        thrust * SEA_LEVEL_KG_M3 * p.diameter_m**4 / turn**2,
        "N*s^2/rad^2",
        f"{source}: C_THRUST at rest * 1.225 kg/m^3 * diameter^4 / (2 pi)^2",
    )
    d.number(
        "rotors.torque_from_speed",
        power * SEA_LEVEL_KG_M3 * p.diameter_m**5 / turn**3,
        "N*m*s^2/rad^2",
        f"{source}: C_POWER at rest * 1.225 kg/m^3 * diameter^5 / (2 pi)^3",
    )
    for key in ("spin_inertia", "reaction_inertia"):
        d.number(f"rotors.{key}", p.inertia_kg_m2, "kg*m^2", f"{source}: <ixx>")
    d.number("rotors.diameter", p.diameter_m, "m", f"{source}: <diameter>")
    for key, table, rest in (("thrust", p.thrust, thrust), ("torque", p.power, power)):
        rows = table / np.array([1.0, rest])
        what = "C_THRUST" if key == "thrust" else "C_POWER"
        d.number(f"rotors.{key}_by_advance", rows, "1", f"{source}: {what} over that at rest")


# -- files ----------------------------------------------------------------------------------


def _parts(path: Path) -> dict[str, Element]:
    """Sections of an aircraft by tag, with those in separate files."""
    root = read_xml(path)
    found: dict[str, Element] = {}
    for section in root:
        file = section.get("file")
        if file is not None and section.tag != "system":
            section = read_xml(_file_in(path, [path.parent], file))
        found.setdefault(str(section.tag), section)
    missing = [k for k in ("mass_balance", "propulsion", "metrics") if k not in found]
    if missing:
        raise ModelError(f"{path.name}: has no {', '.join(missing)}.")
    return found


def _file_in(path: Path, folders: list[Path], name: str) -> Path:
    """Path of a referenced file in one of these folders."""
    if re.fullmatch(r"[A-Za-z0-9_][\w .+-]*", name):
        for folder in folders:
            for file in (folder / name, folder / f"{name}.xml"):
                if file.is_file():
                    return file
    raise ModelError(f"{path.name}: names {name!r}, which is in none of the folders it may be in.")


def _one_propeller(path: Path, engines: list[Element]) -> tuple[_Propeller, list[str]]:
    """The propeller, which all thrusters must share."""
    if not 3 <= len(engines) <= 12:
        raise ModelError(f"{path.name}: has {len(engines)} engines; 3 to 12 rotors can be written.")
    folders = [path.parent, path.parent / "Engines", path.parents[1].parent / "engine"]
    names = set()
    for engine in engines:
        thruster = engine.find("thruster")
        if thruster is None or thruster.get("file") is None:
            raise ModelError(f"{path.name}: engine {engine.get('name')!r} has no thruster file.")
        names.add(str(thruster.get("file")))
        _check_upright(path.name, thruster)
    if len(names) != 1:
        raise ModelError(f"{path.name}: thrusters differ: {', '.join(sorted(names))}.")
    file = _file_in(path, folders, min(names))
    root = read_xml(file)
    if root.tag != "propeller":
        raise ModelError(f"{file.name}: is a <{root.tag}>, not a <propeller>.")
    for tag in ("constspeed", "minpitch", "maxpitch", "gearratio", "p_factor"):
        value = float(floats(file.name, f"<{tag}>", root.findtext(tag, "0"), 1)[0])
        if value not in ((0.0, 1.0) if tag == "gearratio" else (0.0,)):
            raise ModelError(f"{file.name}: <{tag}> {value:g}: only a fixed propeller is written.")
    tables = {t.get("name"): _table(file.name, t) for t in root.findall("table")}
    for needed in ("C_THRUST", "C_POWER"):
        if needed not in tables:
            raise ModelError(f"{file.name}: has no table {needed}.")
    diameter = _quantity(file.name, root, "diameter", "IN")
    inertia = _quantity(file.name, root, "ixx", "SLUG*FT2")
    return _Propeller(diameter, inertia, tables["C_THRUST"], tables["C_POWER"]), [file.name]


def _table(file: str, table: Element) -> Array:
    words = table.findtext("tableData") or ""
    values = floats(file, f"table {table.get('name')}", words, len(words.split()))
    rows = [line for line in words.splitlines() if line.strip()]
    if len(values) != 2 * len(rows):
        raise ModelError(f"{file}: table {table.get('name')} must have two columns.")
    return values.reshape(-1, 2)


def _check_upright(file: str, thruster: Element) -> None:
    """Refuse a thruster whose thrust is not along body -z, or depends on the angle of attack."""
    orient = thruster.find("orient")
    angles = np.zeros(3)
    if orient is not None:
        tags = ("roll", "pitch", "yaw")
        angles = _factor(file, orient.get("unit", "RAD")) * np.array(
            [float(floats(file, f"<{t}>", orient.findtext(t, "0"), 1)[0]) for t in tags]
        )
    if np.abs(angles - [0.0, np.pi / 2, 0.0]).max() > 1e-6:
        raise ModelError(f"{file}: a thruster is tilted; rotors here push along body z.")
    if float(floats(file, "<p_factor>", thruster.findtext("p_factor", "0"), 1)[0]):
        raise ModelError(f"{file}: a <p_factor> is not written.")


# -- body -----------------------------------------------------------------------------------


def _body(file: str, balance: Element) -> MassProperties:
    """Mass, centre of mass in body axes from the origin of the structural frame, and inertia."""
    products = [_quantity(file, balance, k, "SLUG*FT2", 0.0) for k in ("ixy", "ixz", "iyz")]
    if any(products):
        raise ModelError(f"{file}: products of inertia {products} are not read.")
    if balance.find("pointmass") is not None:
        raise ModelError(f"{file}: <pointmass> is not read; put it into <emptywt> and <ixx>...")
    moments = [_quantity(file, balance, f"i{a}{a}", "SLUG*FT2") for a in "xyz"]
    mass = _quantity(file, balance, "emptywt", "LBS")
    return combined([MassProperties(mass, _location(file, balance), np.diag(moments))])


def _location(file: str, parent: Element) -> Array:
    """Position in body axes FRD: the structural frame is x aft, y right, z up."""
    location = parent.find("location")
    if location is None:
        raise ModelError(f"{file}: <{parent.tag}> has no <location>.")
    unit = location.get("unit", "IN")
    x, y, z = (floats(file, f"<{a}>", location.findtext(a), 1)[0] for a in "xyz")
    return _factor(file, unit) * np.array([-x, y, -z])


def _lowest_contact(file: str, ground: Element | None) -> float | None:
    """Distance of the lowest contact point below the origin, m; None without any."""
    if ground is None:
        return None
    places = [_location(file, c)[2] for c in ground.findall("contact")]
    return float(max(places)) if places else None


def _quantity(
    file: str, parent: Element, tag: str, unit: str, default: float | None = None
) -> float:
    """A number in SI units; `unit` is the default of JSBSim where the file names none."""
    child = parent.find(tag)
    if child is None and default is not None:
        return default
    text = None if child is None else child.text
    value = float(floats(file, f"<{tag}>", text, 1)[0])
    return value * _factor(file, unit if child is None else child.get("unit", unit))


def _factor(file: str, unit: str) -> float:
    if unit not in _TO_SI:
        raise ModelError(f"{file}: unit {unit!r} is not known here: {', '.join(_TO_SI)}.")
    return _TO_SI[unit]


# -- aerodynamics ---------------------------------------------------------------------------


def _drag(file: str, parts: Mapping[str, Element]) -> float:
    """Drag over the square of the speed, N s2/m2, at the density of sea level.

    Raises:
        ModelError: The functions include another force or moment than drag of a constant
            coefficient.
    """
    aerodynamics = parts.get("aerodynamics")
    if aerodynamics is None:
        return 0.0
    known: dict[str, Terms] = {}
    for function in aerodynamics.findall("function"):
        known[str(function.get("name"))] = _evaluate(file, function, known)
    drag = 0.0
    for axis in aerodynamics.findall("axis"):
        name = axis.get("name")
        total = _added([_evaluate(file, f, known) for f in axis.findall("function")])
        constant = total.pop((_DYNAMIC_PRESSURE_AREA,), 0.0) if name == "DRAG" else 0.0
        if any(total.values()) or name not in (*_FORCES, "DRAG"):
            raise ModelError(
                f"{file}: aerodynamics of axis {name} are no drag of a constant coefficient; a "
                f"vehicle file has no place for them."
            )
        drag += constant
    area = _quantity(file, parts["metrics"], "wingarea", "FT2")
    return 0.5 * SEA_LEVEL_KG_M3 * area * drag


def _evaluate(file: str, element: Element, known: Mapping[str, Terms]) -> Terms:
    """Terms of a JSBSim function made of sums and products."""
    parts = [p for p in element if p.tag != "description"]
    if element.tag in ("value", "v"):
        return {(): float(floats(file, "<value>", element.text, 1)[0])}
    if element.tag in ("property", "p"):
        name = (element.text or "").strip()
        return dict(known.get(name, {(name,): 1.0}))
    terms = [_evaluate(file, p, known) for p in parts]
    if element.tag == "function" and len(terms) == 1:
        return terms[0]
    if element.tag == "sum":
        return _added(terms)
    if element.tag == "product":
        product: Terms = {(): 1.0}
        for factor in terms:
            product = _added(
                [
                    {tuple(sorted((*a, *b))): x * y}
                    for a, x in product.items()
                    for b, y in factor.items()
                ]
            )
        return product
    raise ModelError(f"{file}: <{element.tag}> in aerodynamics is not read.")


def _added(terms: list[Terms]) -> Terms:
    """Sum of terms, without those of factor zero."""
    total: Terms = {}
    for part in terms:
        for key, value in part.items():
            total[key] = total.get(key, 0.0) + value
    return {k: v for k, v in total.items() if v != 0.0}
