"""`modelDescription.xml` of FMI 2.0 and FMI 3.0 from one interface table."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from datetime import UTC, datetime

from lxml import etree

from twin.component import Enumeration, Variable
from twin.errors import FmuError

from .documentation import project
from .model import Entry, ExchangeState, FmuModel, check_interface
from .names import DISPLAY_UNITS, base_exponents, usual_size

_TYPES = {
    2: {
        "real": "Real",
        "integer": "Integer",
        "boolean": "Boolean",
        "enumeration": "Enumeration",
    },
    3: {
        "real": "Float64",
        "integer": "Int32",
        "boolean": "Boolean",
        "enumeration": "Enumeration",
    },
}
"""Names of the variable types, by FMI version."""


def model_description(model: FmuModel, fmi: int, token: str, sources: Sequence[str]) -> bytes:
    """The XML file; value references count from 1 in the order of the interface table.

    Raises:
        FmuError: A name or a text of the model is not allowed in an FMU.
    """
    check_interface(model)
    root = _fmi2(model, token, sources) if fmi == 2 else _fmi3(model, token)
    if token:  # the date is not part of the token
        root.attrib.update(dated())
    return xml_bytes(root)


def build_description(model: FmuModel, sources: Sequence[str]) -> bytes:
    """`sources/buildDescription.xml` of FMI 3.0: how to compile the FMU."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=model.name)
    files = etree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        etree.SubElement(files, "SourceFile", name=name)
    return xml_bytes(root)


def xml_bytes(root: etree._Element) -> bytes:
    """An XML document, as UTF-8."""
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def _fmi2(model: FmuModel, token: str, sources: Sequence[str]) -> etree._Element:
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=token,
        description=model.description,
        **_made_by(),
        variableNamingConvention="structured",
        numberOfEventIndicators=str(len(model.exchange.crossings) if model.exchange else 0),
    )
    common = {
        "modelIdentifier": model.name,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    kinds = {"CoSimulation": {"canHandleVariableCommunicationStepSize": "true"}}
    if model.exchange is not None:
        kinds = {"ModelExchange": {"completedIntegratorStepNotNeeded": "true"}, **kinds}
    for kind, own in kinds.items():
        simulation = etree.SubElement(root, kind, **common, **own)
        files = etree.SubElement(simulation, "SourceFiles")
        for name in sources:
            etree.SubElement(files, "File", name=name)
    _unit_definitions(root, model)
    _type_definitions(root, model, fmi=2)
    _log_categories(root)
    _default_experiment(root, model)
    table = etree.SubElement(root, "ModelVariables")
    index = {v.name: i for i, v in enumerate(model.variables, start=1)}
    states = states_of(model)
    for reference, variable in enumerate(model.variables, start=1):
        scalar = etree.SubElement(
            table,
            "ScalarVariable",
            name=variable.name,
            valueReference=str(reference),
            description=variable.description,
            causality=variable.causality,
            variability=_variability(variable, model.held),
        )
        if _computed(variable):
            scalar.set("initial", "calculated")
        element = _type_element(scalar, _TYPES[2], variable)
        _of_exchange(element, Entry(variable.name, (variable,)), states, index)
    structure = etree.SubElement(root, "ModelStructure")
    for group, names, dependencies in _unknowns(model):
        if not names and group == "Derivatives":
            continue
        unknowns = etree.SubElement(structure, group)
        for name in names:
            on = sorted(index[k] for k in dependencies[name])
            etree.SubElement(
                unknowns, "Unknown", index=str(index[name]), dependencies=" ".join(map(str, on))
            )
    return root


def _fmi3(model: FmuModel, token: str) -> etree._Element:
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=model.name,
        instantiationToken=token,
        description=model.description,
        **_made_by(),
        variableNamingConvention="structured",
    )
    common = {
        "modelIdentifier": model.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
    }
    if model.exchange is not None:
        etree.SubElement(root, "ModelExchange", **common, needsCompletedIntegratorStep="false")
    etree.SubElement(root, "CoSimulation", **common, canHandleVariableCommunicationStepSize="true")
    _unit_definitions(root, model)
    _type_definitions(root, model, fmi=3)
    _log_categories(root)
    _default_experiment(root, model)
    table = etree.SubElement(root, "ModelVariables")
    etree.SubElement(
        table,
        "Float64",
        name="time",
        valueReference="0",
        description="Simulation time",
        causality="independent",
        variability="continuous",
        unit="s",
    )
    entries = model.entries
    reference_of = {v.name: i for i, e in enumerate(entries, start=1) for v in e.members}
    states = states_of(model)
    for reference, entry in enumerate(entries, start=1):
        variable = entry.first
        element = _type_element(table, _TYPES[3], variable)
        attributes = {
            "name": entry.name,
            "valueReference": str(reference),
            "description": entry.description,
            "causality": variable.causality,
            "variability": _variability(variable, model.held),
        }
        if _computed(variable):
            attributes["initial"] = "calculated"
        for key, value in attributes.items():
            element.set(key, value)
        _of_exchange(element, entry, states, reference_of)
        if entry.is_array:
            _array(element, entry)
    structure = etree.SubElement(root, "ModelStructure")
    tags = {
        "Outputs": "Output",
        "Derivatives": "ContinuousStateDerivative",
        "InitialUnknowns": "InitialUnknown",
        "EventIndicators": "EventIndicator",
    }
    for group, names, dependencies in _unknowns(model, indicators=True):
        tag = tags[group]
        together: dict[int, set[int]] = {}
        for name in names:
            on = {reference_of[k] for k in dependencies[name]}
            together.setdefault(reference_of[name], set()).update(on)
        for reference, known in together.items():
            etree.SubElement(
                structure,
                tag,
                valueReference=str(reference),
                dependencies=" ".join(map(str, sorted(known))),
            )
    return root


def _array(element: etree._Element, entry: Entry) -> None:
    """Set dimensions, start value and nominal of an array."""
    if not _computed(entry.first):
        element.set("start", " ".join(repr(float(v.start)) for v in entry.members))
        sizes = (usual_size(v) for v in entry.members)
        element.set("nominal", repr(max(sizes)))
    etree.SubElement(element, "Dimension", start=str(len(entry.members)))


def _made_by() -> dict[str, str]:
    """Attributes on the tool, for both versions."""
    made = project()
    return {
        "author": made.author,
        "version": made.version,
        "copyright": made.copyright,
        "license": made.licence,
        "generationTool": made.name,
    }


def dated() -> dict[str, str]:
    """Attribute `generationDateAndTime` from SOURCE_DATE_EPOCH (reproducible-builds.org).

    Raises:
        FmuError: It is no number of seconds since 1970.
    """
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if not text:
        return {}
    try:
        made = datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError):
        raise FmuError(
            f"SOURCE_DATE_EPOCH={text}: give whole seconds since 1970, or none."
        ) from None
    return {"generationDateAndTime": made.strftime("%Y-%m-%dT%H:%M:%SZ")}


def _computed(variable: Variable) -> bool:
    return variable.causality in ("output", "local")


def states_of(model: FmuModel) -> dict[str, ExchangeState]:
    """Continuous states by the variable of each, and by that of its derivative."""
    states = model.exchange.states if model.exchange else ()
    return {s.name: s for s in states} | {s.derivative: s for s in states}


def _of_exchange(
    element: etree._Element,
    entry: Entry,
    states: Mapping[str, ExchangeState],
    number: Mapping[str, int],
) -> None:
    """Set attributes of a state or a derivative; of other variables none."""
    if entry.first.name not in states:
        return
    own = [states[v.name] for v in entry.members]
    if entry.first.name == own[0].derivative:
        here = [number[state.name] for state in own]
        assert [*number.values()].count(here[0]) == here.count(here[0]) == len(here), entry.name
        element.set("derivative", str(here[0]))
        return
    element.set("nominal", repr(max(state.nominal for state in own)))
    if any(state.jumps for state in own):
        element.set("reinit", "true")


def _unknowns(
    model: FmuModel, indicators: bool = False
) -> Iterator[tuple[str, list[str], dict[str, set[str]]]]:
    """Groups of the model structure: name, variables, dependencies of each.

    A derivative and an event indicator depend on states and inputs. So does an output in model
    exchange; in co-simulation the states are internal, and it depends on inputs only.
    """
    exchange = model.exchange
    states = exchange.states if exchange else ()
    now = {
        name: {*inputs, *(exchange.depends[name] if exchange else ())}
        for name, inputs in model.dependencies.items()
    }
    start = {name: set(known) for name, known in model.initial_dependencies.items()}
    outputs = [v.name for v in model.variables if v.causality == "output"]
    derivatives = [s.derivative for s in states]
    hidden = [s.name for s in states if s.name not in outputs]
    yield "Outputs", outputs, now
    yield "Derivatives", derivatives, now
    yield "InitialUnknowns", [*outputs, *hidden, *derivatives], start
    if indicators and exchange is not None:
        yield "EventIndicators", list(exchange.crossings), now


def _variability(variable: Variable, held: Set[str]) -> str:
    if variable.causality == "parameter":
        return "fixed" if variable.fixed else "tunable"
    return "continuous" if variable.real and variable.name not in held else "discrete"


def _type_element(
    parent: etree._Element, types: Mapping[str, str], variable: Variable
) -> etree._Element:
    """Type element with unit, range and start value."""
    element = etree.SubElement(parent, types[variable.kind_name])
    number: Callable[[float], str] = repr if variable.real else lambda v: str(int(v))
    if variable.real:
        element.set("unit", variable.unit)
    if isinstance(variable.kind, Enumeration):
        element.set("declaredType", variable.kind.name)
    elif not variable.boolean:
        if variable.minimum is not None:
            element.set("min", number(float(variable.minimum)))
        if variable.maximum is not None:
            element.set("max", number(float(variable.maximum)))
    if variable.real:
        if variable.unit in DISPLAY_UNITS:
            element.set("displayUnit", DISPLAY_UNITS[variable.unit][0])
        element.set("nominal", repr(usual_size(variable)))
    if not _computed(variable):
        text = variable.start_text if variable.boolean else number(float(variable.start))
        element.set("start", text)
    return element


def _unit_definitions(root: etree._Element, model: FmuModel) -> None:
    definitions = etree.SubElement(root, "UnitDefinitions")
    for name in sorted({v.unit for v in model.variables if v.real} | {"s"}):
        unit = etree.SubElement(definitions, "Unit", name=name)
        etree.SubElement(unit, "BaseUnit", {k: str(e) for k, e in base_exponents(name).items()})
        if name in DISPLAY_UNITS:
            shown, factor = DISPLAY_UNITS[name]
            etree.SubElement(unit, "DisplayUnit", name=shown, factor=repr(factor))


def _type_definitions(root: etree._Element, model: FmuModel, fmi: int) -> None:
    """Add the enumerations, with the same codes as in the rest of the twin."""
    if not model.enumerations:
        return
    definitions = etree.SubElement(root, "TypeDefinitions")
    for kind in model.enumerations:
        if fmi == 2:
            simple = etree.SubElement(definitions, "SimpleType", name=kind.name)
            listed = etree.SubElement(simple, "Enumeration")
        else:
            listed = etree.SubElement(definitions, "EnumerationType", name=kind.name)
        for code, item in enumerate(kind.items):
            etree.SubElement(listed, "Item", name=item, value=str(code))


STEP_S = 0.01
"""Default communication step: a tenth of the computation of 1 ms, with the same internal step."""
TOLERANCE = 1e-8
"""Default relative tolerance, in model exchange."""
CATEGORIES = {
    "logStatusError": "Errors",
    "logEvents": "Begin and end, events, reset and restored states; only when asked for",
}  # log categories and their content


def _log_categories(root: etree._Element) -> None:
    categories = etree.SubElement(root, "LogCategories")
    for name, description in CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=description)


def _default_experiment(root: etree._Element, model: FmuModel) -> None:
    experiment = etree.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=repr(STEP_S)
    )
    if model.exchange is not None:
        experiment.set("tolerance", repr(TOLERANCE))
