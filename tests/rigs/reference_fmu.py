"""FMUs after the models of the Reference FMUs, compiled from `reference_fmu.c`, FMI 2 and 3.

The Reference FMUs themselves (github.com/modelica/Reference-FMUs) are in no package registry.
"""

import subprocess
import zipfile
from pathlib import Path

REAL, INTEGER, BOOLEAN, ENUMERATION = "Float64", "Int32", "Boolean", "Enumeration"
Row = tuple[str, int, str, str, str]
"""Name, value reference, FMI 3 type, causality, start value ("": calculated)."""
_KINDS = {"a": REAL, "b": REAL, "n": INTEGER, "flag": BOOLEAN, "option": ENUMERATION}
MODELS: dict[str, tuple[float, float, list[Row]]] = {
    "DAHLQUIST": (0.1, 10.0, [("x", 1, REAL, "output", ""), ("k", 2, REAL, "parameter", "1")]),
    "VAN_DER_POL": (
        0.01,
        20.0,
        [
            ("x0", 1, REAL, "output", ""),
            ("x1", 2, REAL, "output", ""),
            ("mu", 3, REAL, "parameter", "1"),
        ],
    ),
    "BOUNCING_BALL": (
        0.01,
        3.0,
        [
            ("h", 1, REAL, "output", ""),
            ("v", 2, REAL, "output", ""),
            ("e", 4, REAL, "parameter", "0.7"),
        ],
    ),
    "STAIR": (0.2, 10.0, [("counter", 1, INTEGER, "output", "")]),
    "FEEDTHROUGH": (
        0.1,
        2.0,
        [
            *(
                (f"{n}_in", i, k, "input", {BOOLEAN: "false", ENUMERATION: "1"}.get(k, "0"))
                for i, (n, k) in enumerate(_KINDS.items(), start=1)
            ),
            *((f"{n}_out", i, k, "output", "") for i, (n, k) in enumerate(_KINDS.items(), 11)),
        ],
    ),
    "RESOURCE": (0.1, 1.0, [("y", 1, INTEGER, "output", "")]),
    "STATE_SPACE": (0.1, 10.0, [("u", 1, REAL, "input", "1 2 3"), ("y", 11, REAL, "output", "")]),
}
"""Name -> communication step and stop time of the default experiment, s, and variables."""
ARRAYS = ("STATE_SPACE",)
"""Those of FMI 3 alone."""


def reference_fmu(model: str, fmi: int, folder: Path) -> Path:
    """Build one."""
    library, fmu = folder / f"{model}{fmi}.so", folder / f"{model}{fmi}.fmu"
    source = Path(__file__).with_suffix(".c")
    defines = [f"-DMODEL={model}", f"-DFMI={fmi}"]
    command = ["cc", "-shared", "-fPIC", "-O1", "-w", "-ffp-contract=off", *defines]
    subprocess.run([*command, "-o", library, source, "-lm"], check=True)
    place = "binaries/linux64" if fmi == 2 else "binaries/x86_64-linux"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", _description(model, fmi))
        archive.writestr(f"{place}/{model}.so", library.read_bytes())
        archive.writestr("resources/y.txt", "a")
    return fmu


def _description(model: str, fmi: int) -> str:
    step_s, stop_s, rows = MODELS[model]
    experiment = f'<DefaultExperiment startTime="0" stopTime="{stop_s}" stepSize="{step_s}"/>'
    variables = "".join((_of_fmi2 if fmi == 2 else _of_fmi3)(row, model in ARRAYS) for row in rows)
    items = "".join(f'<Item name="option {i}" value="{i}"/>' for i in (1, 2))
    head = '<?xml version="1.0" encoding="UTF-8"?>'
    slave = (
        f'<CoSimulation modelIdentifier="{model}" canHandleVariableCommunicationStepSize="true"/>'
    )
    outputs = [i for i, row in enumerate(rows, start=1) if row[3] == "output"]
    if fmi == 2:
        listed = "".join(f'<Unknown index="{i}"/>' for i in outputs)
        types = f'<SimpleType name="Option"><Enumeration>{items}</Enumeration></SimpleType>'
        return (
            f'{head}<fmiModelDescription fmiVersion="2.0" modelName="{model}" guid="1" '
            f'numberOfEventIndicators="0">{slave}<TypeDefinitions>{types}</TypeDefinitions>'
            f"{experiment}<ModelVariables>{variables}</ModelVariables><ModelStructure><Outputs>"
            f"{listed}</Outputs><InitialUnknowns>{listed}</InitialUnknowns></ModelStructure>"
            f"</fmiModelDescription>"
        )
    time = (
        '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
    )
    listed = "".join(
        f'<{tag} valueReference="{rows[i - 1][1]}"/>'
        for tag in ("Output", "InitialUnknown")
        for i in outputs
    )
    types = f'<EnumerationType name="Option">{items}</EnumerationType>'
    return (
        f'{head}<fmiModelDescription fmiVersion="3.0" modelName="{model}" instantiationToken="1">'
        f"{slave}<TypeDefinitions>{types}</TypeDefinitions>{experiment}<ModelVariables>{time}"
        f"{variables}</ModelVariables><ModelStructure>{listed}</ModelStructure></fmiModelDescription>"
    )


def _shared(row: Row) -> str:
    name, reference, kind, causality, start = row
    variability = "tunable" if causality == "parameter" else "discrete"
    if kind == REAL and causality != "parameter":
        variability = "continuous"
    initial = 'initial="calculated"' if not start else ""
    return (
        f'name="{name}" valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}" {initial}'
    )


def _of_fmi2(row: Row, array: bool) -> str:
    kind, start = {REAL: "Real", INTEGER: "Integer"}.get(row[2], row[2]), row[4]
    declared = 'declaredType="Option"' if kind == ENUMERATION else ""
    value = f'start="{start}"' if start else ""
    return f"<ScalarVariable {_shared(row)}><{kind} {declared} {value}/></ScalarVariable>"


def _of_fmi3(row: Row, array: bool) -> str:
    kind, start = row[2], row[4]
    declared = 'declaredType="Option"' if kind == ENUMERATION else ""
    value = f'start="{start}"' if start else ""
    size = '<Dimension start="3"/>' if array else ""
    return f"<{kind} {_shared(row)} {declared} {value}>{size}</{kind}>"
