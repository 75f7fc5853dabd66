"""Documentation inside an FMU: a page, licences, an icon, and the definition of its terminals.

The page describes the FMU, its use, its frames, variables and effects. FMI 2.0.1 section 2.3 and
FMI 3.0 section 2.5.1: `documentation/index.html` is the entry page for tools,
`documentation/licenses/license.txt` is the licence, from the metadata of the installed package.
`icon.png` is `icon.svg`, rendered by a browser.

`terminalsAndIcons.xml` of FMI 3.0 groups variables. Variables of one name have the same meaning in
every component, so outputs of an airframe and inputs of an IMU are terminals of one name, whose
members a tool connects by name.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata, resources

import jinja2
from lxml import etree

from twin.component import Variable
from twin.effects import EFFECTS, Effect

from ..model import FmuModel

_NAME = "uavtwin"  # name of the installed package


@dataclass(frozen=True, slots=True)
class Project:
    """Facts of this project that every FMU contains.

    Attributes:
        name: Name of the tool.
        version: Version of the package.
        author: Author of the code.
        licence: Short name of the licence (SPDX).
        copyright: Copyright line of the licence.
        text: Full text of the licence. The FMI headers among the sources contain their own.
    """

    name: str
    version: str
    author: str
    licence: str
    copyright: str
    text: str


@cache
def project() -> Project:
    """Facts of this installation."""
    own = metadata.distribution(_NAME)
    text = own.read_text("licenses/LICENSE") or ""
    line = next((line for line in text.splitlines() if line.startswith("Copyright")), "")
    header = own.metadata
    return Project(
        _NAME, own.version, header["Author"] or "", header["License-Expression"] or "", line, text
    )


ICON_MM = 20
"""Edge of the icon on a drawing, mm."""


@dataclass(frozen=True, slots=True)
class Bus:
    """A kind of terminal.

    Attributes:
        name: Name of the terminal.
        description: Description in one line.
        members: Pattern of the names of its variables.
    """

    name: str
    description: str
    members: str


_SIGNALS = ("input", "output")  # causalities of connected variables
_XYZ = "_[xyz]"  # suffix of a vector's names
BUSES = (
    Bus("motor_commands", "What the controller asks of each motor", r"cmd_\d+"),
    Bus("rotors", "What each rotor does", r"(rotor|spin_rate|spin|thrust)_\d+"),
    Bus(
        "motion",
        "Position, velocity, attitude and rates of the vehicle, and what they change by",
        rf"(pos|vel|omega|specific_force|angular_acceleration){_XYZ}|q_[wxyz]",
    ),
    Bus("air", "Wind and density", rf"wind{_XYZ}|density"),
    Bus("outside", "Force and moment from outside", rf"(force|moment){_XYZ}"),
    Bus("power", "Voltage and current of the battery", r"vbat_v|ibat_a"),
    Bus("setpoint", "What the mission asks of the controller", r"setpoint_\w+|armed"),
    Bus(
        "sensors",
        "Readings of all sensors",
        rf"(acc|gyro|mag|meas_pos|meas_vel){_XYZ}|meas_q_[wxyz]|baro_pa",
    ),
)
"""Groups of variables, by pattern of their names."""


def terminals_and_icons(model: FmuModel) -> bytes:
    """The XML file; in a fused FMU each part has a terminal of its name that contains its own
    ones."""
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    graphics = etree.SubElement(root, "GraphicalRepresentation")
    square = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    scale = repr(ICON_MM / 200)
    etree.SubElement(graphics, "CoordinateSystem", square, suggestedScalingFactorTo_mm=scale)
    etree.SubElement(graphics, "Icon", square)
    terminals = etree.Element("Terminals")
    names = {e.first.name: e.name for e in model.entries if e.first.causality in _SIGNALS}
    if len(model.parts) == 1:
        terminals.extend(_terminals(names, ""))
    else:
        for part in model.parts:
            own = list(_terminals(names, f"{part.name}."))
            if own:
                _terminal(terminals, part.name, f"Of the part {part.name}").extend(own)
    if len(terminals):
        root.append(terminals)
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def _terminals(names: Mapping[str, str], prefix: str) -> Iterator[etree._Element]:
    """Terminals of the buses with members among the names with the prefix.

    Args:
        names: Names by identifier: the scalar that each variable is, or begins with if it is an
            array, and the variable's name.
        prefix: Prefix of the part.
    """
    own = {first.removeprefix(prefix): n for first, n in names.items() if first.startswith(prefix)}
    for bus in BUSES:
        members = [name for first, name in own.items() if re.fullmatch(bus.members, first)]
        if not members:
            continue
        terminal = _terminal(None, bus.name, bus.description)
        for member in members:
            etree.SubElement(
                terminal,
                "TerminalMemberVariable",
                variableName=member,
                memberName=member.removeprefix(prefix),
                variableKind="signal",
            )
        yield terminal


def _terminal(parent: etree._Element | None, name: str, description: str) -> etree._Element:
    attributes = {"name": name, "matchingRule": "bus", "description": description}
    if parent is None:
        return etree.Element("Terminal", attributes)
    return etree.SubElement(parent, "Terminal", attributes)


@dataclass(frozen=True, slots=True)
class EffectRows:
    """An effect that an FMU can switch on.

    Attributes:
        place: Prefix of its parameters, "airframe.rotor_drag".
        effect: The effect.
        numbers: Parameters of the effect, the switch first.
    """

    place: str
    effect: Effect
    numbers: tuple[Variable, ...]


def documentation(model: FmuModel, fmi: int) -> dict[str, bytes]:
    """Members of the archive, with equal bytes for equal models.

    Args:
        model: Model of the FMU; its texts may come from files and are escaped.
        fmi: 2 or 3.
    """
    effects = tuple(effect_rows(model))
    of_effects = {v.name for e in effects for v in e.numbers}
    parameters = [v for v in model.variables if v.causality == "parameter"]
    page = _template().render(
        model=model,
        fmi=fmi,
        project=project(),
        inputs=[v for v in model.variables if v.causality == "input"],
        outputs=[v for v in model.variables if v.causality == "output"],
        locals=[v for v in model.variables if v.causality == "local"],
        parameters=[v for v in parameters if v.name not in of_effects],
        effects=effects,
        arrays=[entry for entry in model.entries if entry.is_array],
    )
    return {
        "documentation/index.html": page.encode(),
        "documentation/licenses/license.txt": project().text.encode(),
        **_icon(model, fmi),
    }


def _icon(model: FmuModel, fmi: int) -> dict[str, bytes]:
    """The icon at the path for each version; in FMI 3 also the terminals."""
    own = resources.files(__package__)
    if fmi == 2:
        return {"model.png": (own / "icon.png").read_bytes()}
    return {
        "terminalsAndIcons/icon.png": (own / "icon.png").read_bytes(),
        "terminalsAndIcons/icon.svg": (own / "icon.svg").read_bytes(),
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_and_icons(model),
    }


def effect_rows(model: FmuModel) -> Iterator[EffectRows]:
    """Effects among the parameters of a model, in their order."""
    blocks: dict[str, list[Variable]] = {}
    for v in model.variables:
        place, _, _ = v.name.rpartition(".")
        if v.causality == "parameter" and place.rpartition(".")[2] in EFFECTS:
            blocks.setdefault(place, []).append(v)
    switched = {p: n for p, n in blocks.items() if f"{p}.enabled" in {v.name for v in n}}
    for place, numbers in switched.items():
        yield EffectRows(place, EFFECTS[place.rpartition(".")[2]], tuple(numbers))


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("page.html.j2")


__all__ = ["documentation", "project"]
