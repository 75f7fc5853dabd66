"""`modelDescription.xml` of FMI 2.0 and FMI 3.0 from one interface table."""

from collections.abc import Sequence

from lxml import etree

from twin.component import Variable

from .documentation.project import project
from .model import FmuModel, check_interface
from .units import base_exponents


def model_description(model: FmuModel, fmi: int, token: str, sources: Sequence[str]) -> bytes:
    """The XML file; value references count from 1 in the order of the interface table.

    Raises:
        FmuError: A name or a text of the model cannot stand in an FMU.
    """
    check_interface(model)
    root = _fmi2(model, token, sources) if fmi == 2 else _fmi3(model, token)
    return _bytes(root)


def build_description(model: FmuModel, sources: Sequence[str]) -> bytes:
    """`sources/buildDescription.xml` of FMI 3.0: how to compile the FMU."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=model.name)
    files = etree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        etree.SubElement(files, "SourceFile", name=name)
    return _bytes(root)


def _bytes(root: etree._Element) -> bytes:
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
        numberOfEventIndicators="0",
    )
    simulation = etree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="true",
    )
    files = etree.SubElement(simulation, "SourceFiles")
    for name in sources:
        etree.SubElement(files, "File", name=name)
    _unit_definitions(root, model)
    categories = etree.SubElement(root, "LogCategories")
    etree.SubElement(categories, "Category", name="logStatusError", description="Errors")
    _default_experiment(root, model)
    table = etree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(model.variables, start=1):
        scalar = etree.SubElement(
            table,
            "ScalarVariable",
            name=variable.name,
            valueReference=str(reference),
            description=variable.description,
            causality=variable.causality,
            variability=_variability(variable),
        )
        if variable.causality == "output":
            scalar.set("initial", "calculated")
        _type_element(scalar, "Boolean" if variable.boolean else "Real", variable)
    index = {v.name: i for i, v in enumerate(model.variables, start=1)}
    structure = etree.SubElement(root, "ModelStructure")
    for group, dependencies in (
        ("Outputs", model.dependencies),
        ("InitialUnknowns", model.initial_dependencies),
    ):
        unknowns = etree.SubElement(structure, group)
        for name in _outputs(model):
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
    etree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives="true",
    )
    _unit_definitions(root, model)
    categories = etree.SubElement(root, "LogCategories")
    etree.SubElement(categories, "Category", name="logStatusError", description="Errors")
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
    for reference, variable in enumerate(model.variables, start=1):
        element = _type_element(table, "Boolean" if variable.boolean else "Float64", variable)
        attributes = {
            "name": variable.name,
            "valueReference": str(reference),
            "description": variable.description,
            "causality": variable.causality,
            "variability": _variability(variable),
        }
        if variable.causality == "output":
            attributes["initial"] = "calculated"
        for key, value in attributes.items():
            element.set(key, value)
    reference_of = {v.name: i for i, v in enumerate(model.variables, start=1)}
    structure = etree.SubElement(root, "ModelStructure")
    for tag, dependencies in (
        ("Output", model.dependencies),
        ("InitialUnknown", model.initial_dependencies),
    ):
        for name in _outputs(model):
            on = sorted(reference_of[k] for k in dependencies[name])
            etree.SubElement(
                structure,
                tag,
                valueReference=str(reference_of[name]),
                dependencies=" ".join(map(str, on)),
            )
    return root


def _made_by() -> dict[str, str]:
    """Attributes of either version; no date, so that the same model gives the same bytes."""
    made = project()
    return {
        "author": made.author,
        "version": made.version,
        "copyright": made.copyright,
        "license": made.licence,
        "generationTool": made.name,
    }


def _outputs(model: FmuModel) -> list[str]:
    return [v.name for v in model.variables if v.causality == "output"]


def _variability(variable: Variable) -> str:
    if variable.causality == "parameter":
        return "fixed" if variable.fixed else "tunable"
    return "discrete" if variable.boolean else "continuous"


def _type_element(parent: etree._Element, tag: str, variable: Variable) -> etree._Element:
    """Type element with unit, range and start value."""
    element = etree.SubElement(parent, tag)
    if variable.boolean:
        if variable.causality != "output":
            element.set("start", "true" if variable.start else "false")
        return element
    element.set("unit", variable.unit)
    if variable.minimum is not None:
        element.set("min", repr(float(variable.minimum)))
    if variable.maximum is not None:
        element.set("max", repr(float(variable.maximum)))
    if variable.causality != "output":
        element.set("start", repr(float(variable.start)))
    return element


def _unit_definitions(root: etree._Element, model: FmuModel) -> None:
    definitions = etree.SubElement(root, "UnitDefinitions")
    for name in sorted({v.unit for v in model.variables if not v.boolean} | {"s"}):
        unit = etree.SubElement(definitions, "Unit", name=name)
        etree.SubElement(unit, "BaseUnit", {k: str(e) for k, e in base_exponents(name).items()})


def _default_experiment(root: etree._Element, model: FmuModel) -> None:
    etree.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=repr(model.longest_step_s)
    )
