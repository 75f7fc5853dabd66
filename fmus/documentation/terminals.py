"""`terminalsAndIcons.xml` of FMI 3.0: which variables belong together, and the icon.

Variables of one name mean the same in every component, so what an airframe gives and an IMU takes
are terminals of one name, whose members a tool joins by theirs.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from lxml import etree

from ..model import FmuModel

ICON_MM = 20
"""Edge of the icon on a drawing, mm."""


@dataclass(frozen=True, slots=True)
class Bus:
    """A kind of terminal.

    Attributes:
        name: Of the terminal.
        description: One line.
        members: Pattern of the names of its variables.
    """

    name: str
    description: str
    members: str


_SIGNALS = ("input", "output")
_XYZ = "_[xyz]"
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


def terminals_and_icons(model: FmuModel) -> bytes:
    """The file; in a fused FMU each part has a terminal of its name that holds its own."""
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
    """One per bus that has members among the names with the prefix.

    Args:
        names: Of what each variable is, or begins with where it is an array, to its own.
        prefix: Of the part.
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
