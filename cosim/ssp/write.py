"""Writer of `.ssp` files: SSP 1.0, one flat system of scalars, with reproducible bytes."""

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path

from lxml import etree

from fmus.description import dated
from fmus.names import IDENTIFIER
from twin.errors import FmuError
from twin.scratch import scratch_file

from ..interface import Interface, Port, read_interface
from ..system import System
from .read import FMU_TYPE, NAMESPACES, OSP, PARAMETER_SET, SET_TYPE, SSD_FILE, tag

_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")  # SI base units
_TOOL = "uavtwin"  # `generationTool`


def write_ssp(system: System, path: Path) -> Path:
    """Write a system with its FMUs and start values.

    libcosim and ecos can read the file (`docs/guide/cosimulation.md`). The FMUs are included
    unchanged, so a tool without SSV uses their exported start values.

    Args:
        system: System to write; its default times and step become the default experiment.
        path: File to write; its folder must exist.

    Returns:
        The path.

    Raises:
        FmuError: The system does not fit its FMUs, or cannot be represented in SSP.
    """
    interfaces = {name: read_interface(fmu) for name, fmu in system.fmus.items()}
    system.check(interfaces)
    sources = _sources(system)
    members = {f"resources/{file}": fmu.read_bytes() for fmu, file in sources.items()}
    members |= {
        f"resources/{name}.ssv": _parameter_set(interfaces[name], starts)
        for name, starts in _starts_of(system).items()
    }
    members[SSD_FILE] = _description(system, path.stem, interfaces, sources)
    _write_archive(path, members)
    return path


def _sources(system: System) -> dict[Path, str]:
    """FMU -> its name in `resources`, plain characters only: not every tool decodes a URI."""
    taken: set[str] = set()
    result: dict[Path, str] = {}
    for name, fmu in system.fmus.items():
        if not IDENTIFIER.fullmatch(name):
            raise FmuError(
                f"slave {name!r}: other tools read only letters, digits and underscores in the "
                f"name of a component. Rename it."
            )
        if fmu in result:
            continue
        file = re.sub(r"[^A-Za-z0-9_.-]", "_", fmu.stem) + ".fmu"
        if file.casefold() in taken:
            file = f"{name}.{file}"
        taken.add(file.casefold())
        result[fmu] = file
    return result


def _starts_of(system: System) -> dict[str, dict[str, float]]:
    starts: dict[str, dict[str, float]] = {}
    for name, value in system.starts.items():
        slave, variable = system.split(name)
        starts.setdefault(slave, {})[variable] = value
    return starts


# -- parameters -----------------------------------------------------------------------------


def _parameter_set(interface: Interface, starts: Mapping[str, float]) -> bytes:
    names = {p: NAMESPACES[p] for p in ("ssc", "ssv")}
    root = etree.Element(tag("ssv:ParameterSet"), nsmap=names)
    root.set("version", "1.0")
    root.set("name", PARAMETER_SET)
    root.set("generationTool", _TOOL)
    parameters = etree.SubElement(root, tag("ssv:Parameters"))
    for name in sorted(starts):
        port = interface.scalar(name)
        parameter = etree.SubElement(parameters, tag("ssv:Parameter"), name=name)
        value = _value(interface, port, float(starts[name]))
        etree.SubElement(parameter, tag(f"ssv:{port.kind}"), value=value)
    return _bytes(root)


def _value(interface: Interface, port: Port, value: float) -> str:
    given = interface.value(port, value)
    if port.kind == "Enumeration":
        return {code: name for name, code in port.items}.get(int(given), str(given))
    return str(given).lower() if port.kind == "Boolean" else repr(given)


# -- structure ------------------------------------------------------------------------------


def _description(
    system: System,
    name: str,
    interfaces: Mapping[str, Interface],
    sources: Mapping[Path, str],
) -> bytes:
    root = etree.Element(tag("ssd:SystemStructureDescription"), nsmap=NAMESPACES)
    about = {"version": "1.0", "name": name, "generationTool": _TOOL, **dated()}
    for key, value in about.items():
        root.set(key, value)
    top = etree.SubElement(root, tag("ssd:System"), name=name)
    elements = etree.SubElement(top, tag("ssd:Elements"))
    starts = _starts_of(system)
    units = _units(interfaces)
    for slave, fmu in system.fmus.items():
        component = etree.SubElement(
            elements,
            tag("ssd:Component"),
            name=slave,
            type=FMU_TYPE,
            source=f"resources/{sources[fmu]}",
            implementation="CoSimulation",
        )
        _connectors(component, system, slave, interfaces[slave], units)
        if slave in starts:
            bindings = etree.SubElement(component, tag("ssd:ParameterBindings"))
            etree.SubElement(
                bindings,
                tag("ssd:ParameterBinding"),
                type=SET_TYPE,
                source=f"resources/{slave}.ssv",
            )
        _period(component, system, slave)
    _connections(top, system)
    _enumerations(root, interfaces)
    _unit_definitions(root, units)
    _experiment(root, system)
    return _bytes(root)


def _connectors(
    component: etree._Element,
    system: System,
    slave: str,
    interface: Interface,
    units: Mapping[str, Mapping[str, str]],
) -> None:
    """Add all scalar inputs and outputs; enumerations, which libcosim refuses, only where
    connected."""
    connected = {n for c in system.connections for n in (c.source, c.target)}
    ports = [interface.ports[n] for n in interface.names("input", "output")]
    shown = [p for p in ports if p.kind != "Enumeration" or f"{slave}.{p.name}" in connected]
    if not shown:
        return
    connectors = etree.SubElement(component, tag("ssd:Connectors"))
    for port in shown:
        connector = etree.SubElement(
            connectors, tag("ssd:Connector"), name=port.name, kind=port.causality
        )
        kind = etree.SubElement(connector, tag(f"ssc:{port.kind}"))
        if port.kind == "Real" and port.unit in units:
            kind.set("unit", port.unit)
        if port.kind == "Enumeration":
            kind.set("name", _enumeration(slave, port))


def _connections(top: etree._Element, system: System) -> None:
    if not system.connections:
        return
    connections = etree.SubElement(top, tag("ssd:Connections"))
    for c in system.connections:
        (a, x), (b, y) = system.split(c.source), system.split(c.target)
        ends = {"startElement": a, "startConnector": x, "endElement": b, "endConnector": y}
        etree.SubElement(connections, tag("ssd:Connection"), ends)


def _enumeration(slave: str, port: Port) -> str:
    return f"{slave}.{port.name}"


def _enumerations(root: etree._Element, interfaces: Mapping[str, Interface]) -> None:
    named = {e.get("name") for e in root.iter(tag("ssc:Enumeration"))}
    ports = {_enumeration(s, p): p for s, i in interfaces.items() for p in i.ports.values()}
    if not named:
        return
    enumerations = etree.SubElement(root, tag("ssd:Enumerations"))
    for name in sorted(named):
        element = etree.SubElement(enumerations, tag("ssc:Enumeration"), name=name)
        for item, value in ports[name].items:
            etree.SubElement(element, tag("ssc:Item"), name=item, value=str(value))


def _units(interfaces: Mapping[str, Interface]) -> dict[str, dict[str, str]]:
    """Units of inputs and outputs with their base units, as the FMUs define them."""
    used = {i.ports[n].unit for i in interfaces.values() for n in i.names("input", "output")}
    units: dict[str, dict[str, str]] = {}
    for interface in interfaces.values():
        for unit in interface.description.unitDefinitions:
            base = unit.baseUnit
            if base is None or unit.name not in used:
                continue
            given = {k: str(int(v)) for k in _EXPONENTS if (v := getattr(base, k))}
            given |= {k: repr(float(getattr(base, k))) for k in ("factor", "offset")}
            if units.setdefault(unit.name, given) != given:
                raise FmuError(
                    f"{interface.path.name}: the unit {unit.name!r} means something else in "
                    f"another FMU of the system."
                )
    return units


def _unit_definitions(root: etree._Element, units: Mapping[str, Mapping[str, str]]) -> None:
    if not units:
        return
    definitions = etree.SubElement(root, tag("ssd:Units"))
    for name in sorted(units):
        unit = etree.SubElement(definitions, tag("ssc:Unit"), name=name)
        etree.SubElement(unit, tag("ssc:BaseUnit"), dict(units[name]))


# -- times ----------------------------------------------------------------------------------


def _period(component: etree._Element, system: System, slave: str) -> None:
    period = system.periods.get(slave, 1)
    if period == 1:
        return
    if system.step_s is None:
        raise FmuError(f"period of {slave!r} = {period}: SSP needs a base step; give step_s.")
    hint = etree.SubElement(_annotation(component), tag("osp:StepSizeHint"))
    hint.set("value", repr(period * system.step_s))


def _experiment(root: etree._Element, system: System) -> None:
    experiment = etree.SubElement(root, tag("ssd:DefaultExperiment"))
    experiment.set("startTime", repr(float(system.start_time_s)))
    if system.stop_time_s is not None:
        experiment.set("stopTime", repr(float(system.stop_time_s)))
    if system.step_s is not None:
        algorithm = etree.SubElement(_annotation(experiment), tag("osp:Algorithm"))
        fixed = etree.SubElement(algorithm, tag("osp:FixedStepAlgorithm"))
        fixed.set("baseStepSize", repr(float(system.step_s)))


def _annotation(parent: etree._Element) -> etree._Element:
    annotations = etree.SubElement(parent, tag("ssd:Annotations"))
    return etree.SubElement(annotations, tag("ssc:Annotation"), type=OSP)


# -- bytes ----------------------------------------------------------------------------------


def _bytes(root: etree._Element) -> bytes:
    content: bytes = etree.tostring(root, pretty_print=True, xml_declaration=True, encoding="UTF-8")
    return content


def _write_archive(path: Path, members: Mapping[str, bytes]) -> None:
    """Write members sorted, with fixed times and modes; FMUs are archives already and are only
    stored."""
    with scratch_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            stored = name.endswith(".fmu")
            info.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
            info.create_system = 3
            info.external_attr = 0o644 << 16
            archive.writestr(info, members[name])
