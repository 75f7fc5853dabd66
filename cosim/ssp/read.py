"""Systems from `.ssp` files of any origin.

The portable subset of SSP 1.0: one flat system of co-simulation FMUs with scalar connectors.
Anything else is refused with a remedy, never ignored silently. Archives are unpacked by the rules
for FMU archives.
"""

import math
import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from lxml import etree

from fmus.archive import archive_members, copy_members, member_problems, parse_xml
from fmus.names import shown
from twin.errors import FmuError

from ..interface import Interface, Port, read_interface
from ..system import Connection, System


def unpack_ssp(path: Path, folder: Path) -> None:
    """Unpack into an empty folder; nothing is written before every member has been checked.

    Raises:
        FmuError: The archive is unsafe or damaged.
    """
    members = archive_members(path, "SSP")
    if problems := member_problems(members):
        raise FmuError(f"{path.name}: refused: {'; '.join(problems[:5])}.")
    try:
        with zipfile.ZipFile(path) as archive:
            copy_members(archive, members, folder)
    except Exception as error:  # zipfile, zlib and lzma raise many kinds on damaged files
        raise FmuError(f"{path.name}: not a readable SSP archive: {error}.") from error


SSD_FILE = "SystemStructure.ssd"  # SSP 1.0
NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}
"""Namespaces with the prefixes that libcosim and ecos expect literally."""
FMU_TYPE = "application/x-fmu-sharedlibrary"  # SSP 1.0, media type
SET_TYPE = "application/x-ssp-parameter-set"  # SSP 1.0, media type
PARAMETER_SET = "initialValues"
"""Name of all parameter sets that are written; ecos applies a set by name."""
OSP = "com.opensimulationplatform"
"""Namespace of annotations with the base step and the step of single slaves, read by libcosim."""


def tag(name: str) -> str:
    """Name of an element as in lxml, for `ssd:System`."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


_KINDS = {
    "input": ("input",),
    "output": ("output",),
    "parameter": ("parameter", "structuralParameter"),
    "calculatedParameter": ("calculatedParameter",),
}  # causalities by kind of connector
_FLATTEN = "Flatten the system in the tool that wrote the file: components side by side."  # way out


class _Folder:
    """A temporary folder that is deleted with the last reference to this object."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="uavtwin-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


def read_ssp(path: Path) -> System:
    """Read a system; its FMUs are unpacked to a folder that exists as long as the system.

    Raises:
        FmuError: Unsafe, damaged, misspelt or outside the portable subset.
    """
    folder = _Folder()
    unpack_ssp(path, folder.path)
    return read_unpacked(path, folder.path, read_structure(path, folder.path), folder)


def read_structure(path: Path, folder: Path) -> etree._Element:
    """The description in an unpacked SSP.

    Raises:
        FmuError: There is none, or it is no XML that is safe to parse.
    """
    ssd = folder / SSD_FILE
    if not ssd.is_file():
        raise FmuError(f"{path.name}: a zip archive without {SSD_FILE}: not an SSP.")
    return parse_xml(path, SSD_FILE, ssd.read_bytes())


def read_unpacked(path: Path, folder: Path, root: etree._Element, keep: object = None) -> System:
    """The system of an unpacked SSP.

    Args:
        path: Path of the SSP, for messages.
        folder: Folder with its files.
        root: Root element of its description.
        keep: Object that keeps the folder while the system is in use.

    Raises:
        FmuError: Misspelt or outside the portable subset.
    """
    return _Reader(path.name, folder, root).system(keep)


@dataclass(frozen=True, slots=True)
class _Component:
    """One component and its connectors in the SSD: name -> kind."""

    fmu: Path
    interface: Interface
    connectors: dict[str, str]


class _Reader:
    """Reader of one description; `file` is for messages."""

    def __init__(self, file: str, folder: Path, root: etree._Element) -> None:
        self.file, self.folder, self.root = file, folder, root
        self.interfaces: dict[Path, Interface] = {}

    def system(self, keep: object) -> System:
        """The whole system."""
        version = self.root.get("version", "")
        if self.root.tag != tag("ssd:SystemStructureDescription") or not version.startswith("1."):
            raise self.error(
                f"{SSD_FILE} is {etree.QName(self.root).localname} {version or 'without version'}; "
                f"SystemStructureDescription 1.0 is read. Export it as SSP 1.0."
            )
        top = self.root.find(tag("ssd:System"))
        if top is None:
            raise self.error("there is no System.")
        if top.find(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}") is not None:
            raise self.error(
                "the system has connectors of its own. Connect components only; what comes from "
                "outside is a start value or an FMU that replays it."
            )
        components = self.components(top)
        interfaces = {name: c.interface for name, c in components.items()}
        starts = dict(self.starts(components, top))
        step_s, periods = self.steps(top)
        experiment = self.root.find(tag("ssd:DefaultExperiment"))
        times = {} if experiment is None else experiment.attrib
        system = System(
            fmus={name: c.fmu for name, c in components.items()},
            connections=tuple(self.connections(top, components)),
            starts=starts,
            periods=periods,
            start_time_s=self.number(times.get("startTime", "0"), "startTime"),
            stop_time_s=self.number(times["stopTime"], "stopTime") if "stopTime" in times else None,
            step_s=step_s,
            foreign=True,
            folder=keep,
        )
        try:
            system.check(interfaces)
        except FmuError as error:
            raise self.error(str(error)) from None
        return system

    # -- components -------------------------------------------------------------------------

    def components(self, top: etree._Element) -> dict[str, _Component]:
        """All components by name."""
        result: dict[str, _Component] = {}
        for element in top.iterfind(f"{tag('ssd:Elements')}/{{*}}*"):
            kind, name = etree.QName(element).localname, element.get("name", "")
            if kind != "Component" or element.get("type", FMU_TYPE) != FMU_TYPE:
                raise self.error(f"{name!r} is a {kind} that is no FMU. {_FLATTEN}")
            if not name or "." in name or name in result:
                raise self.error(
                    f"component name {name!r} is empty, holds a dot or comes twice. Rename it."
                )
            if element.get("implementation") == "ModelExchange":
                raise self.error(f"{name!r} asks for model exchange. Export it for co-simulation.")
            fmu = self.local_file(element.get("source", ""), name)
            interface = self.interface(fmu)
            result[name] = _Component(fmu, interface, self.connectors(element, name, interface))
        if not result:
            raise self.error("the system has no components.")
        return result

    def interface(self, fmu: Path) -> Interface:
        """Interface of an FMU, read once for any number of components."""
        if fmu not in self.interfaces:
            try:
                self.interfaces[fmu] = read_interface(fmu)
            except FmuError as error:
                raise self.error(str(error)) from None
        return self.interfaces[fmu]

    def connectors(
        self, component: etree._Element, name: str, interface: Interface
    ) -> dict[str, str]:
        """Declared connectors, checked against the FMU."""
        result: dict[str, str] = {}
        for element in component.iterfind(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}"):
            variable, kind = element.get("name", ""), element.get("kind", "")
            if variable not in interface.ports:
                raise self.missing(f"connector of {name!r}", variable, interface.ports)
            port = interface.ports[variable]
            if port.causality not in _KINDS.get(kind, ()):
                raise self.error(
                    f"connector {name}.{variable} is {kind!r}, but {port.causality} in the FMU."
                )
            for child in element.iterchildren(tag("ssc:*")):
                self.check_type(child, f"{name}.{variable}", port)
            result[variable] = kind
        return result

    def check_type(self, element: etree._Element, what: str, port: Port) -> None:
        """Type and unit of a connector or a parameter value."""
        kind, unit = etree.QName(element).localname, element.get("unit")
        if port.kind is not None and kind != port.kind:
            raise self.error(f"{what} is {kind}, but {port.kind} in the FMU.")
        if unit and port.unit and unit != port.unit:
            raise self.error(
                f"{what} is in {unit}, but in {port.unit} in the FMU; units are not converted. "
                f"Give it in {port.unit}."
            )

    # -- connections ------------------------------------------------------------------------

    def connections(
        self, top: etree._Element, components: Mapping[str, _Component]
    ) -> Iterator[Connection]:
        """Connections from output to input, for either order of the ends in the file."""
        for element in top.iterfind(f"{tag('ssd:Connections')}/{tag('ssd:Connection')}"):
            ends = []
            for end in ("start", "end"):
                slave, variable = element.get(f"{end}Element"), element.get(f"{end}Connector", "")
                if slave is None:
                    raise self.error(f"connection with the system's own {variable!r}. {_FLATTEN}")
                if slave not in components:
                    raise self.missing("component", slave, components)
                if variable not in components[slave].connectors:
                    raise self.missing(
                        f"connector of {slave!r}", variable, components[slave].connectors
                    )
                ends.append((components[slave].connectors[variable], f"{slave}.{variable}"))
            (kind, source), (other, target) = ends
            if (kind, other) == ("input", "output"):
                source, target = target, source
            elif (kind, other) != ("output", "input"):
                raise self.error(
                    f"{source} ({kind}) -> {target} ({other}): only outputs and inputs can be "
                    f"connected. Set a parameter by a start value."
                )
            self.refuse_transformation(element, f"{source} -> {target}")
            yield Connection(source, target)

    def refuse_transformation(self, connection: etree._Element, what: str) -> None:
        """Refuse a transformation, unless it changes nothing."""
        for child in connection.iterchildren("{*}*"):
            name = etree.QName(child).localname
            if not name.endswith("Transformation"):
                continue
            factor = self.number(child.get("factor", "1"), "factor")
            offset = self.number(child.get("offset", "0"), "offset")
            if name != "LinearTransformation" or (factor, offset) != (1, 0):
                raise self.error(
                    f"{what} has a {name} (factor {factor:g}, offset {offset:g}), which is not "
                    f"supported. Put an FMU between that does it."
                )

    # -- start values -----------------------------------------------------------------------

    def starts(
        self, components: Mapping[str, _Component], top: etree._Element
    ) -> Iterator[tuple[str, float]]:
        """Start values in order of increasing priority: components, then the system."""
        for element in top.iterfind(f"{tag('ssd:Elements')}/{tag('ssd:Component')}"):
            yield from self.bindings(element, components, f"{element.get('name')}.")
        yield from self.bindings(top, components, "")

    def bindings(
        self, owner: etree._Element, components: Mapping[str, _Component], scope: str
    ) -> Iterator[tuple[str, float]]:
        """Start values bound by one element."""
        inside = f"{tag('ssd:ParameterValues')}/{tag('ssv:ParameterSet')}"
        for b in owner.iterfind(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
            source = b.get("source")
            if b.get("type", SET_TYPE) != SET_TYPE or b.get("sourceBase", "SSD") != "SSD":
                raise self.error(f"parameters of {source!r} are no SSV file inside the archive.")
            if b.find(tag("ssd:ParameterMapping")) is not None:
                raise self.error(
                    "a parameter binding has a mapping, which is not supported. Use the names of "
                    "the FMU's variables in the parameter set."
                )
            if source:
                file = self.local_file(source, "a parameter binding")
                values = parse_xml(Path(self.file), source, file.read_bytes())
            else:
                values = b.find(inside)
            if values is None or values.tag != tag("ssv:ParameterSet"):
                raise self.error(f"{source or 'an inline parameter set'} is no SSV parameter set.")
            for parameter in values.iter(tag("ssv:Parameter")):
                yield self.start(
                    parameter, scope + b.get("prefix", "") + parameter.get("name", ""), components
                )

    def start(
        self, parameter: etree._Element, name: str, components: Mapping[str, _Component]
    ) -> tuple[str, float]:
        """One start value."""
        slave, _, variable = name.partition(".")
        if slave not in components:
            raise self.missing("component", slave, components)
        ports = components[slave].interface.ports
        if variable not in ports:
            raise self.missing(f"variable of {slave!r}", variable, ports)
        port = ports[variable]
        value = next(parameter.iterchildren("{*}*"), None)
        if value is None or port.kind is None:
            raise self.error(f"{name} has no value that could be set; {port.type} in the FMU.")
        self.check_type(value, name, port)
        text = value.get("value", "")
        if port.kind == "Enumeration":
            items = dict(port.items)
            if text not in items:
                raise self.missing(f"value of {name}", text, items)
            return name, float(items[text])
        if port.kind == "Boolean":
            text = {"true": "1", "false": "0"}.get(text, text)
        return name, self.number(text, name)

    # -- steps ------------------------------------------------------------------------------

    def steps(self, top: etree._Element) -> tuple[float | None, dict[str, int]]:
        """Base step and periods from the annotations of the Open Simulation Platform."""
        annotation = f"{tag('ssd:Annotations')}/{tag('ssc:Annotation')}[@type='{OSP}']"
        fixed = self.root.find(
            f"{tag('ssd:DefaultExperiment')}/{annotation}/{tag('osp:Algorithm')}"
            f"/{tag('osp:FixedStepAlgorithm')}"
        )
        step_s = None if fixed is None else self.positive(fixed.get("baseStepSize", ""), "step")
        periods: dict[str, int] = {}
        for element in top.iterfind(f"{tag('ssd:Elements')}/{tag('ssd:Component')}"):
            hint = element.find(f"{annotation}/{tag('osp:StepSizeHint')}")
            if hint is None or step_s is None:
                continue
            ratio = self.positive(hint.get("value", ""), "StepSizeHint") / step_s
            if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
                raise self.error(
                    f"{element.get('name')} steps every {hint.get('value')} s, no whole number of "
                    f"base steps of {step_s:g} s."
                )
            if round(ratio) > 1:
                periods[element.get("name", "")] = round(ratio)
        return step_s, periods

    # -- helpers ----------------------------------------------------------------------------

    def local_file(self, source: str, what: str) -> Path:
        """Path of a file inside the archive."""
        parts = urlsplit(source)
        inside = PurePosixPath(unquote(parts.path))
        outside = parts.scheme or parts.netloc or inside.is_absolute() or ".." in inside.parts
        if not source or outside or parts.fragment:
            raise self.error(f"{what} refers to {shown(source)}, which is not inside the archive.")
        file = self.folder / inside
        try:
            found = file.is_file()
        except OSError:  # no file can have such a name
            found = False
        if not found:
            raise self.error(f"{what} refers to {shown(source)}, which is not in the archive.")
        return file

    def number(self, text: str, what: str) -> float:
        """A finite number from the file."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{what} = {text!r} is no finite number.")
        return value

    def positive(self, text: str, what: str) -> float:
        """A number of seconds above 0."""
        value = self.number(text, what)
        if value <= 0:
            raise self.error(f"{what} = {text!r} must be above 0 s, e.g. 0.001.")
        return value

    def missing(self, kind: str, name: str, known: Iterable[str]) -> FmuError:
        """The error for a misspelt name."""
        near = get_close_matches(name, known := list(known), n=1, cutoff=0.5)
        hint = f"Did you mean {near[0]!r}?" if near else f"Known: {', '.join(known[:20])}."
        return self.error(f"there is no {kind} {name!r}. {hint}")

    def error(self, text: str) -> FmuError:
        """An error that names the file."""
        return FmuError(f"{self.file}: {text}")
