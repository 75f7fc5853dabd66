"""Links, joints and poses of an SDF model, included models merged in."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ....errors import ModelError
from .rigid import HERE, MassProperties, Pose, pose_of
from .xml import Element, floats, number, read_xml

_DEEPEST = 5
"""Models that include models that include models."""


@dataclass(slots=True)
class Model:
    """One model with everything that it includes.

    Attributes:
        name: Of the model.
        file: For errors.
        links: By name.
        joints: By name.
        frames: By name.
        plugins: Of the model and of those that it includes.
        outside: Pose of each included element's own model frame in that of this model, by name.
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
            ModelError: There is none of this name, or poses go in a circle.
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
    """Models of an SDF file, in it or in a world of it.

    Raises:
        ModelError: It is not SDF, or a model that is included cannot be found.
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
    """Put what an element of a model holds into the model."""
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
    """The model that an include names, from a folder next to that of the file."""
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
    """What the `<pose>` of an element says, no matter in which frame.

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
    """The rigid part that a link is, its pose given.

    Raises:
        ModelError: It has no mass or no inertia written out.
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
        ModelError: There is none.
    """
    text = (element.findtext(tag) or "").strip()
    if not text:
        raise ModelError(f"{file}: {element.tag} {element.get('name')!r} has no <{tag}>.")
    return text
