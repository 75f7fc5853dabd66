"""One way to drive an extracted FMU whatever its FMI version; imported fast, by many processes."""

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import fmpy
import numpy as np
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Instance:
    """An FMU behind FMPy; what it says through the logger is in `messages`."""

    model_types: tuple[type, type] = (FMU2Slave, FMU3Slave)

    def __init__(self, folder: Path, instantiated: bool = True) -> None:
        description = fmpy.read_model_description(str(folder))
        self.fmi = 2 if description.fmiVersion.startswith("2") else 3
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.types = {v.name: v.type for v in description.modelVariables}
        self.output_names = [v.name for v in description.modelVariables if v.causality == "output"]
        self.messages: list[str] = []
        self.fmu = self.model_types[self.fmi - 2](
            guid=description.guid if self.fmi == 2 else description.instantiationToken,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=str(folder),
            instanceName="tested",
        )
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda *a: self.messages.append(a[4].decode())
        )
        self._callbacks.allocateMemory = defaultCallbacks.allocateMemory
        self._callbacks.freeMemory = defaultCallbacks.freeMemory
        if instantiated:
            self.instantiate()

    def instantiate(self) -> None:
        """Make the instance; the library is loaded."""
        if self.fmi == 2:
            self.fmu.instantiate(callbacks=self._callbacks)
        else:
            self.fmu.instantiate(logMessage=lambda *a: self.messages.append(a[3].decode()))

    def enter(self, starts: Mapping[str, float] | None = None, time_s: float = 0.0) -> None:
        """Set start values and enter initialisation."""
        if self.fmi == 2:
            self.fmu.setupExperiment(startTime=time_s)
        self.set(starts or {})
        if self.fmi == 2:
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time_s)

    def leave(self) -> None:
        """End initialisation."""
        self.fmu.exitInitializationMode()

    def start(self, starts: Mapping[str, float] | None = None, time_s: float = 0.0) -> Self:
        """Initialise."""
        self.enter(starts, time_s)
        self.leave()
        return self

    def set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            cast = {"Boolean": bool, "Real": float, "Float64": float}.get(self.types[name], int)
            self._call("set", name)([self.reference[name]], [cast(value)])

    def get(self, name: str) -> float:
        return float(self._call("get", name)([self.reference[name]])[0])

    def outputs(self) -> Array:
        return np.array([self.get(name) for name in self.output_names])

    def step(self, time_s: float, step_s: float = 1e-3) -> None:
        self.fmu.doStep(time_s, step_s)

    def run(self, steps: int, first: int = 0, step_s: float = 1e-3) -> Array:
        """All outputs after each step, shape (steps, n)."""
        rows = []
        for k in range(first, first + steps):
            self.step(k * step_s, step_s)
            rows.append(self.outputs())
        return np.array(rows)

    def close(self) -> None:
        self.fmu.freeInstance()

    def _call(self, verb: str, name: str) -> Any:
        kind = self.types[name]
        if kind == "Enumeration":
            kind = "Integer" if self.fmi == 2 else "Int64"
        return getattr(self.fmu, verb + kind)


def unzip(path: Path, folder: Path) -> Path:
    """Extract an FMU."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    return folder


def library(folder: Path) -> Path:
    """The shared library of an extracted FMU."""
    (found,) = folder.glob("binaries/*/*.so")
    return found


def token(folder: Path) -> str:
    """GUID or instantiation token of an extracted FMU."""
    xml = (folder / "modelDescription.xml").read_text()
    match = re.search(r'(?:guid|instantiationToken)="([^"]+)"', xml)
    assert match
    return match[1]
