"""A quadrotor of PyFlyt (`NAME.yaml` and `NAME.urdf` next to it) as a vehicle file.

The laws are those of its class QuadX; `docs/reference/simulators.md` lists them.
"""

import re
from pathlib import Path

import numpy as np

from ...errors import ModelError
from ..write import Draft
from .common import (
    FLU_TO_FRD,
    HERE,
    Element,
    MassProperties,
    Pose,
    combined,
    floats,
    pose_of,
    read_xml,
    six_elements,
    turned,
)

DIRECTIONS = ["ccw", "ccw", "cw", "cw"]
"""Directions of the four motors, fixed in QuadX: front right, rear left, front left, rear right."""
DENSITY_KG_M3 = 1.225
"""Air density in its drag law, which is constant."""
_NEEDED = {
    "motor_params": ("total_thrust", "thrust_coef", "torque_coef", "tau", "noise_ratio"),
    "drag_params": ("drag_coef_xyz", "drag_area_xyz", "drag_coef_pqr"),
}  # sections and keys that are read
Numbers = dict[str, dict[str, float]]


def is_pyflyt(text: str) -> bool:
    """Whether the text of a YAML file looks like a multirotor of PyFlyt."""
    return all(re.search(rf"^{section}:", text, re.MULTILINE) for section in _NEEDED)


def convert_pyflyt(text: str, path: Path) -> str:
    """Text of a vehicle file for a QuadX, its YAML given as text.

    Raises:
        ModelError: A number is missing, there is no URDF next to the YAML, or it is not a rigid
            quadrotor.
    """
    its = _read_sections(text, path.name)
    motor, drag = its["motor_params"], its["drag_params"]
    urdf = path.with_suffix(".urdf")
    if not urdf.is_file():
        raise ModelError(
            f"{path.name}: mass, inertia and rotors are in {urdf.name}, which must lie next to it."
        )
    body, props = _read_urdf(urdf)
    if motor["thrust_coef"] <= 0 or motor["total_thrust"] <= 0:
        raise ModelError(f"{path.name}: thrust_coef and total_thrust must be positive.")
    if motor["torque_coef"] < 0:
        raise ModelError(
            f"{path.name}: torque_coef = {motor['torque_coef']:g} is negative, against the "
            f"directions that QuadX fixes."
        )

    d = Draft(path.stem, f"{path.stem} of PyFlyt, QuadX", path.name)
    d.notes.append(
        f"Converted from {path.name} and {urdf.name} of PyFlyt. Left out, as no numbers of the "
        f"aircraft: control_params, and noise_ratio = {motor['noise_ratio']:g}, random throttle "
        f"at every step of 1/240 s."
    )
    d.notes.append(
        "Differences of law: drag_coef_pqr slows turns to one side and speeds those to the other "
        "up in QuadX (it squares the rate and drops its sign), here it slows both. PyFlyt loads "
        "the URDF without its inertia and lets Bullet take that of the collision shapes; this is "
        "the one that the URDF gives. Legs are not in the files."
    )
    by = urdf.name
    d.number("body.mass", body.mass_kg, "kg", f"masses of all links in {by}")
    d.number(
        "body.inertia",
        six_elements(turned(body.inertia_kg_m2)),
        "kg*m^2",
        f"inertias of all links in {by}, turned to FRD",
    )
    shape = 0.5 * DENSITY_KG_M3 * drag["drag_coef_xyz"] * drag["drag_area_xyz"]
    d.number(
        "body.drag_quadratic",
        np.full(3, shape),
        "N*s^2/m^2",
        f"0.5 * {DENSITY_KG_M3} kg/m^3 * drag_coef_xyz * drag_area_xyz",
    )
    d.number(
        "body.drag_angular", np.full(3, drag["drag_coef_pqr"]), "N*m*s^2/rad^2", "drag_coef_pqr"
    )
    hubs = np.stack([p.origin - body.centre_m for p in props]) * FLU_TO_FRD + 0.0
    d.number("rotors.position", hubs, "m", f"first four links in {by}, turned to FRD")
    d.words("rotors.direction", DIRECTIONS, "fixed in PyFlyt's QuadX")
    d.number("rotors.thrust_from_speed", motor["thrust_coef"], "N/rpm^2", "thrust_coef")
    d.number("rotors.torque_from_speed", motor["torque_coef"], "N*m/rpm^2", "torque_coef")
    top = float(np.sqrt(motor["total_thrust"] / (4 * motor["thrust_coef"])))
    d.polynomial(
        "rotors.speed_from_command",
        np.array([0.0, top]),
        "rpm",
        "throttle times sqrt(total_thrust / (4 thrust_coef))",
    )
    d.number("rotors.lag", motor["tau"], "s", "tau")
    return d.text()


def _read_sections(text: str, file: str) -> Numbers:
    """Numbers of the two relevant sections, in the YAML format of PyFlyt's own files.

    One number per indented line `key: number`; other sections are ignored.
    """
    its: Numbers = {}
    section = ""
    for row, raw in enumerate(text.splitlines(), start=1):
        line = re.sub(r"(^|\s)#.*$", "", raw).rstrip()
        if not line:
            continue
        if not line[0].isspace():
            section = line.removesuffix(":")
            continue
        if section not in _NEEDED:
            continue
        match = re.fullmatch(r"\s+(\w+):\s*(\S+)", line)
        if match is None:
            raise ModelError(f"{file}, line {row}: {line.strip()!r} is not 'key: number'.")
        key, value = match.groups()
        its.setdefault(section, {})[key] = float(floats(file, f"{section}.{key}", value, 1)[0])
    for part, keys in _NEEDED.items():
        missing = [k for k in keys if k not in its.get(part, {})]
        if missing:
            raise ModelError(f"{file}: {part} has no {', '.join(missing)}.")
    return its


# -- URDF -----------------------------------------------------------------------------------


def _read_urdf(path: Path) -> tuple[MassProperties, list[Pose]]:
    """All links as one rigid body, and the centres of the four links with motors, FLU.

    Bullet numbers links by their joints; a force on a link acts at its centre of mass.
    """
    robot = read_xml(path)
    if robot.tag != "robot":
        raise ModelError(f"{path.name}: has a root <{robot.tag}>, not <robot>.")
    links = {link.get("name"): link for link in robot.findall("link")}
    joints = robot.findall("joint")
    moving = [j.get("name") for j in joints if j.get("type") != "fixed"]
    if moving:
        raise ModelError(f"{path.name}: joints that move: {', '.join(moving)}; QuadX has none.")
    children = [_named(path.name, j, "child") for j in joints]
    roots = [name for name in links if name not in children]
    if len(roots) != 1 or len(joints) < len(DIRECTIONS):
        raise ModelError(f"{path.name}: needs one base link and a joint for each of four motors.")
    poses = {roots[0]: HERE}
    for joint, child in zip(joints, children, strict=True):
        parent = _named(path.name, joint, "parent")
        if parent not in poses or child not in links:
            raise ModelError(
                f"{path.name}: joint {joint.get('name')!r} must come after that of its parent link "
                f"{parent!r}, and its child {child!r} must be a link."
            )
        poses[child] = poses[parent].of(_origin(path.name, joint))
    parts, centres = [], {}
    for name, pose in poses.items():
        inertial = links[name].find("inertial")
        if inertial is None:
            raise ModelError(
                f"{path.name}: link {name!r} has no <inertial>; Bullet gives it 1 kg. Write it out."
            )
        centres[name] = pose.of(_origin(path.name, inertial))
        parts.append(_link_mass(path.name, inertial, centres[name]))
    if sum(p.mass_kg for p in parts) <= 0:
        raise ModelError(f"{path.name}: its links have no mass.")
    props = [centres[c] for c in children[: len(DIRECTIONS)]]
    if any(abs(p.axes[2, 2] - 1) > 1e-6 for p in props):
        raise ModelError(f"{path.name}: a motor link is tilted; rotors here push along body z.")
    return combined(parts), props


def _link_mass(file: str, inertial: Element, pose: Pose) -> MassProperties:
    values = _attributes(inertial.find("mass")) | _attributes(inertial.find("inertia"))
    names = ("value", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    mass, xx, yy, zz, xy, xz, yz = (
        float(floats(file, f"<inertial> {n}", values.get(n, ""), 1)[0]) for n in names
    )
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return MassProperties(mass, pose.origin, pose.axes @ J @ pose.axes.T)


def _origin(file: str, parent: Element) -> Pose:
    """Pose in `<origin xyz rpy>`, which is optional."""
    its = _attributes(parent.find("origin"))
    place, turn = (floats(file, f"<origin> {k}", its.get(k, "0 0 0"), 3) for k in ("xyz", "rpy"))
    return pose_of(place.tolist(), turn.tolist())


def _attributes(element: Element) -> dict[str, str]:
    return {} if element is None else dict(element.attrib)


def _named(file: str, joint: Element, end: str) -> str:
    name = _attributes(joint.find(end)).get("link")
    if name is None:
        raise ModelError(f"{file}: joint {joint.get('name')!r} has no {end} link.")
    return name
