"""A multirotor of Gazebo (SDF with MulticopterMotorModel plugins) as a vehicle file.

The laws are those of the plugin; `docs/reference/simulators.md` lists them. The plugin of Gazebo
classic in PX4's repository (`libgazebo_motor_model.so`) has another one: thrust falls with forward
speed. It is refused.

The first part reads the SDF model: links, joints and poses, with included models merged.
"""

import re
from dataclasses import dataclass, field
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
    number,
    pose_of,
    read_xml,
    six_elements,
    turned,
)

_DEEPEST = 5
"""Largest depth of nested model includes."""


@dataclass(slots=True)
class Model:
    """One model with all included ones.

    Attributes:
        name: Name of the model.
        file: Path of the file, for errors.
        links: Links by name.
        joints: Joints by name.
        frames: Frames by name.
        plugins: Plugins of the model and of included ones.
        outside: Pose of an included model's frame in the frame of this model, by name of the
            included element.
    """

    name: str
    file: str
    links: dict[str, Element] = field(default_factory=dict)
    joints: dict[str, Element] = field(default_factory=dict)
    frames: dict[str, Element] = field(default_factory=dict)
    plugins: list[Element] = field(default_factory=list)
    outside: dict[str, Pose] = field(default_factory=dict)

    def pose(self, name: str, seen: tuple[str, ...] = ()) -> Pose:
        """Pose of a link, joint or frame in the frame of this model.

        Raises:
            ModelError: There is none of this name, or the poses are circular.
        """
        if name in seen:
            raise ModelError(f"{self.file}: poses of {' and '.join(seen)} go in a circle.")
        for kind in (self.links, self.frames, self.joints):
            if name in kind:
                element = kind[name]
                break
        else:
            raise ModelError(f"{self.file}: there is no link, joint or frame {name!r}.")
        base = self.outside.get(name, HERE)
        given = element.find("pose")
        relative = "" if given is None else given.get("relative_to", given.get("frame", ""))
        if not relative and kind is self.joints:
            relative = text_of(self.file, element, "child")
        if not relative and kind is self.frames:
            relative = element.get("attached_to", "")
        if relative and relative != "__model__":
            base = self.pose(relative, (*seen, name))
        return base.of(own_pose(self.file, element))


def read_models(path: Path) -> list[Model]:
    """Models of an SDF file, at top level or in its world.

    Raises:
        ModelError: The file is not SDF, or an included model cannot be found.
    """
    root = read_xml(path)
    if root.tag != "sdf":
        raise ModelError(f"{path.name}: has a root <{root.tag}>, not <sdf>.")
    found = []
    for element in [*root.findall("model"), *root.findall("world/model")]:
        model = Model(element.get("name", path.stem), path.name)
        _gather(model, element, path, HERE, 0)
        found.append(model)
    return found


def _gather(model: Model, element: Element, path: Path, outside: Pose, depth: int) -> None:
    """Add the content of a model's element to the model."""
    for kind, tag in ((model.links, "link"), (model.joints, "joint"), (model.frames, "frame")):
        for child in element.findall(tag):
            name = child.get("name", "")
            if name in kind:
                raise ModelError(f"{path.name}: {tag} {name!r} is there twice.")
            kind[name] = child
            if outside is not HERE:
                model.outside[name] = outside
    model.plugins += element.findall("plugin")
    if element.find("model") is not None:
        raise ModelError(f"{path.name}: a model inside a model is not read; include it instead.")
    for include in element.findall("include"):
        if depth == _DEEPEST:
            raise ModelError(f"{path.name}: models include each other more than {_DEEPEST} deep.")
        other, there = _included(path, include)
        its_own = other if include.find("pose") is None else include
        if include.get("merge") != "true":
            name = include.findtext("name") or other.get("name", "")
            raise ModelError(
                f'{path.name}: {name!r} is included without merge="true", as a model of its own; '
                f"write the model out with: gz sdf -p {path.name}"
            )
        _gather(model, other, there, outside.of(own_pose(path.name, its_own)), depth + 1)


def _included(path: Path, include: Element) -> tuple[Element, Path]:
    """Element and file of an included model, from a folder next to that of the file."""
    uri = (include.findtext("uri") or "").strip()
    match = re.fullmatch(r"(?:model://)?([A-Za-z0-9_][A-Za-z0-9_-]*)/?", uri)
    file = path.resolve().parent.parent / match[1] / "model.sdf" if match else None
    if file is None or not file.is_file():
        raise ModelError(
            f"{path.name}: includes {uri!r}, which is not in a folder next to that of the file; "
            f"write the model out with: gz sdf -p {path.name}"
        )
    model = read_xml(file).find("model")
    if model is None:
        raise ModelError(f"{file.parent.name}/{file.name}: holds no model.")
    return model, file


def own_pose(file: str, element: Element) -> Pose:
    """Content of an element's `<pose>`, without regard to its frame.

    Raises:
        ModelError: It is not six numbers.
    """
    given = element.find("pose")
    if given is None or not (given.text or "").strip():
        return HERE
    if given.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise ModelError(f"{file}: a pose with quaternions is not read; write roll, pitch, yaw.")
    values = floats(file, "<pose>", given.text, 6)
    turn = np.deg2rad(values[3:]) if given.get("degrees") == "true" else values[3:]
    return pose_of(values[:3].tolist(), turn.tolist())


def link_mass(file: str, name: str, link: Element, pose: Pose) -> MassProperties:
    """Mass properties of a link with a given pose.

    Raises:
        ModelError: It has no explicit mass or no inertia.
    """
    inertial = link.find("inertial")
    inertia = None if inertial is None else inertial.find("inertia")
    if inertial is None or inertia is None or inertial.get("auto") == "true":
        raise ModelError(
            f"{file}: link {name!r} has no <inertial> with <mass> and <inertia>; SDF gives such a "
            f"link 1 kg and 1 kg m^2. Write them out."
        )
    xx, yy, zz = (number(file, inertia, f"i{a}{a}") for a in "xyz")
    xy, xz, yz = (
        0.0 if inertia.find(k) is None else number(file, inertia, k) for k in ("ixy", "ixz", "iyz")
    )
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    at = pose.of(own_pose(file, inertial))
    return MassProperties(number(file, inertial, "mass"), at.origin, at.axes @ J @ at.axes.T)


def text_of(file: str, element: Element, tag: str) -> str:
    """Text of a child element.

    Raises:
        ModelError: There is no such child.
    """
    text = (element.findtext(tag) or "").strip()
    if not text:
        raise ModelError(f"{file}: {element.tag} {element.get('name')!r} has no <{tag}>.")
    return text


_PLUGIN = "MulticopterMotorModel"  # plugin of gz-sim
_ROTORS_PLUGIN = "librotors_gazebo_motor_model.so"  # plugin of RotorS
_DEFAULTS = {
    "maxRotVelocity": 838.0,
    "momentConstant": 0.016,
    "motorConstant": 8.54858e-06,
    "rollingMomentCoefficient": 1.0e-6,
    "rotorDragCoefficient": 1.0e-4,
    "rotorVelocitySlowdownSim": 10.0,
    "timeConstantDown": 1.0 / 40.0,
    "timeConstantUp": 1.0 / 80.0,
}
"""Defaults of the plugin for missing elements, by its source."""
_UPRIGHT = 1e-6
"""Largest deviation of the cosine between a rotor axis and the body axis."""


@dataclass(frozen=True, slots=True)
class _Motor:
    """One motor plugin.

    Attributes:
        index: Index of its command.
        link: Link of the rotor.
        joint: Joint of the rotor.
        direction: "cw" or "ccw", seen from above.
        numbers: Numbers by element.
        left_out: Missing elements, for which the plugin's default is used.
    """

    index: int
    link: str
    joint: str
    direction: str
    numbers: dict[str, float]
    left_out: tuple[str, ...]


def convert_gazebo(path: Path, name: str | None) -> str:
    """Text of a vehicle file for a multirotor of an SDF file; `name` selects one of several.

    Raises:
        ModelError: The file has no such multirotor, its rotors differ or are tilted, or a link has
            no explicit inertia.
    """
    models = {m.name: m for m in read_models(path) if any(map(_is_motor, m.plugins))}
    if name is None and len(models) == 1:
        (name,) = models
    if name not in models:
        if not models:
            raise ModelError(f"{path.name}: holds no model with plugins {_PLUGIN}.")
        asked = "say which model" if name is None else f"there is no multirotor {name!r}"
        raise ModelError(f"{path.name}: {asked}; it holds: {', '.join(models)}.")
    model = models[name]
    motors = sorted((_motor(model, p) for p in model.plugins if _is_motor(p)), key=_place)
    if [m.index for m in motors] != list(range(len(motors))):
        raise ModelError(
            f"{path.name}: motorNumber runs {[m.index for m in motors]}, not from 0 without gaps."
        )
    for motor in motors[1:]:
        for key, value in motor.numbers.items():
            if value != motors[0].numbers[key]:
                raise ModelError(
                    f"{path.name}: <{key}> is {motors[0].numbers[key]:g} for {motors[0].link} and "
                    f"{value:g} for {motor.link}; a vehicle file has rotors of one kind."
                )
    return _draft(path, model, motors).text()


def _place(motor: _Motor) -> int:
    return motor.index


def _is_motor(plugin: Element) -> bool:
    name, file = plugin.get("name", ""), plugin.get("filename", "")
    return bool(name.split("::")[-1] == _PLUGIN or file.endswith(_ROTORS_PLUGIN))


def _motor(model: Model, plugin: Element) -> _Motor:
    file = model.file
    kind = (plugin.findtext("motorType") or "velocity").strip()
    if kind != "velocity":
        raise ModelError(f"{file}: motorType {kind!r}; the plugin itself knows 'velocity' alone.")
    direction = text_of(file, plugin, "turningDirection")
    if direction not in ("cw", "ccw"):
        raise ModelError(f"{file}: turningDirection is {direction!r}, neither 'cw' nor 'ccw'.")
    given = {
        key: float(floats(file, f"<{key}>", plugin.findtext(key), 1)[0])
        for key in _DEFAULTS
        if plugin.find(key) is not None
    }
    tag = "actuator_number" if plugin.find("motorNumber") is None else "motorNumber"
    return _Motor(
        index=int(floats(file, f"<{tag}>", plugin.findtext(tag), 1)[0]),
        link=text_of(file, plugin, "linkName"),
        joint=text_of(file, plugin, "jointName"),
        direction=direction,
        numbers=_DEFAULTS | given,
        left_out=tuple(sorted(_DEFAULTS.keys() - given)),
    )


def _draft(path: Path, model: Model, motors: list[_Motor]) -> Draft:
    file, its = model.file, motors[0].numbers
    base = model.pose(_base(model, motors))
    poses = {link: model.pose(link).relative_to(base) for link in model.links}
    body = combined([link_mass(file, n, e, poses[n]) for n, e in model.links.items()])
    if its["rotorVelocitySlowdownSim"] <= 0 or its["maxRotVelocity"] <= 0:
        raise ModelError(f"{file}: rotorVelocitySlowdownSim and maxRotVelocity must be positive.")
    d = Draft(model.name, f"{model.name} of Gazebo, {_PLUGIN}", path.name)
    _note(d, model, motors)

    def source(key: str) -> str:
        return f"default of {_PLUGIN}, {key}" if key in motors[0].left_out else f"<{key}>"

    d.number("body.mass", body.mass_kg, "kg", "masses of all links")
    d.number(
        "body.inertia",
        six_elements(turned(body.inertia_kg_m2)),
        "kg*m^2",
        "inertias of all links, rotors at angle 0, turned to FRD",
    )
    hubs = np.stack([poses[m.link].origin - body.centre_m for m in motors]) * FLU_TO_FRD + 0.0
    d.number("rotors.position", hubs, "m", "poses of the rotor links, turned to FRD")
    d.words("rotors.direction", [m.direction for m in motors], "<turningDirection>")
    d.number(
        "rotors.thrust_from_speed", its["motorConstant"], "N*s^2/rad^2", source("motorConstant")
    )
    d.number("rotors.torque_per_thrust", its["momentConstant"], "m", source("momentConstant"))
    d.words("rotors.command_range", [0.0, its["maxRotVelocity"]], source("maxRotVelocity"))
    d.polynomial(
        "rotors.speed_from_command",
        np.array([0.0, 1.0]),
        "rad/s",
        "the plugin's command is the speed in rad/s",
    )
    d.number(
        "rotors.lag",
        np.array([its["timeConstantUp"], its["timeConstantDown"]]),
        "s",
        f"{source('timeConstantUp')}, {source('timeConstantDown')}",
    )
    about = _rotor_inertia(model, motors)
    slow = its["rotorVelocitySlowdownSim"]
    for key in ("spin_inertia", "reaction_inertia"):
        d.number(
            f"rotors.{key}",
            about / slow,
            "kg*m^2",
            f"<izz> of a rotor, {about:g} kg m^2, which turns {slow:g} times slower than it "
            f"pushes, {source('rotorVelocitySlowdownSim')}",
        )
    d.number("rotors.drag", its["rotorDragCoefficient"], "kg/rad", source("rotorDragCoefficient"))
    d.number(
        "rotors.rolling_moment",
        its["rollingMomentCoefficient"],
        "kg*m/rad",
        source("rollingMomentCoefficient"),
    )
    sensors = [
        poses[n].of(own_pose(file, s)).origin
        for n, e in model.links.items()
        for s in e.findall("sensor")
        if s.get("type") == "imu"
    ]
    if len(sensors) == 1:
        place = (sensors[0] - body.centre_m) * FLU_TO_FRD + 0.0
        d.number("imu.position", place, "m", 'pose of the sensor of type "imu", turned to FRD')
    return d


def _note(d: Draft, model: Model, motors: list[_Motor]) -> None:
    """Add notes on omitted numbers and defaults."""
    d.notes.append(
        f"Converted from {d.file} of Gazebo, model {model.name}. Left out: collision shapes, so "
        f"legs too, noise of sensors, plugins other than {_PLUGIN}."
    )
    if motors[0].left_out:
        d.notes.append(
            f"Not in the file, so the defaults of the plugin: {', '.join(motors[0].left_out)}."
        )
    turning = {m.joint for m in motors}
    moving = [n for n, j in model.joints.items() if n not in turning and j.get("type") != "fixed"]
    if moving:
        d.notes.append(f"Joints that move are held at 0: {', '.join(moving)}.")


def _base(model: Model, motors: list[_Motor]) -> str:
    """The link to which the rotors are attached, whose axes are those of the body."""
    parents = set()
    for motor in motors:
        if motor.link not in model.links or motor.joint not in model.joints:
            raise ModelError(
                f"{model.file}: the plugin of {motor.link} needs that link and joint "
                f"{motor.joint}; the model has links {', '.join(model.links)}."
            )
        parents.add(text_of(model.file, model.joints[motor.joint], "parent"))
    if len(parents) != 1:
        raise ModelError(f"{model.file}: rotors hang on several links: {', '.join(parents)}.")
    (base,) = parents
    for motor in motors:
        _check_upright(model, motor, model.pose(motor.link).relative_to(model.pose(base)))
    return base


def _check_upright(model: Model, motor: _Motor, rotor: Pose) -> None:
    """Refuse a rotor whose thrust or axis is not along body z."""
    axis = model.joints[motor.joint].find("axis/xyz")
    along = np.array([0.0, 0.0, 1.0])
    if axis is not None:
        along = floats(model.file, "<xyz>", axis.text, 3)
        frame = axis.get("expressed_in", "")
        seen = model.pose(frame or motor.joint).relative_to(model.pose(motor.link))
        along = seen.axes @ along / np.linalg.norm(along)
    if 1 - rotor.axes[2, 2] > _UPRIGHT or 1 - along[2] > _UPRIGHT:
        raise ModelError(
            f"{model.file}: rotor {motor.link} is tilted; rotors here push along body z."
        )


def _rotor_inertia(model: Model, motors: list[_Motor]) -> float:
    """Inertia of one rotor link about its own axis, kg m2, the same for all."""
    parts = [link_mass(model.file, m.link, model.links[m.link], HERE) for m in motors]
    found = [float(p.inertia_kg_m2[2, 2]) for p in parts]
    if max(found) - min(found) > 1e-9 * max(found):
        raise ModelError(f"{model.file}: <izz> differs between rotors: {sorted(found)}.")
    return max(found)
