"""FMUs that misbehave, compiled from `bad_fmu.c`: how, says the name of the slave.

With the parameter `bad` at 0 their steps are fine.
"""

import subprocess
import zipfile
from importlib import resources
from pathlib import Path

_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="bad" guid="{bad}" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="bad" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="y" valueReference="0" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="bad" valueReference="1" causality="parameter" variability="fixed">
      <Real start="1"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="1" dependencies=""/></Outputs></ModelStructure>
</fmiModelDescription>
"""


def bad_fmu(folder: Path, name: str = "bad", flags: tuple[str, ...] = (), cut: int = 0) -> Path:
    """Build one.

    Args:
        folder: To write to.
        name: Of the file.
        flags: Of the compiler: `-DMISSING` leaves a function out.
        cut: Bytes of the library to keep; 0: all.
    """
    library = folder / f"{name}.so"
    source = Path(__file__).with_name("bad_fmu.c")
    headers = resources.files("fmpy") / "c-code"
    command = ["cc", "-shared", "-fPIC", "-O0", "-w", f"-I{headers}", *flags]
    subprocess.run([*command, "-o", library, source, "-lm", "-lpthread"], check=True)
    fmu = folder / f"{name}.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", _DESCRIPTION)
        content = library.read_bytes()
        archive.writestr("binaries/linux64/bad.so", content[: cut or len(content)])
    return fmu
