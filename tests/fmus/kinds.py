"""The FMUs that the tests look at, and one way to drive them whatever their FMI version."""

import re
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from fmus import FmuModel, component_model, fuse, replay_model
from twin.airframe import airframe
from twin.battery import battery
from twin.component import Component
from twin.component_builder import ComponentBuilder
from twin.flightlog import Flight
from twin.imu import imu
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]

COMPONENTS: dict[str, Callable[[], Component]] = {
    "airframe-feisi_x150": lambda: airframe(load_vehicle("feisi_x150")),
    "airframe-copter_default": lambda: airframe(load_vehicle("copter_default")),
    "airframe-crazyflie": lambda: airframe(load_vehicle("crazyflie")),
    "airframe-rotor_speed": lambda: airframe(load_vehicle("copter_default"), "rotor_speed"),
    "imu": lambda: imu(load_vehicle("copter_default")),
    "imu-filtered": lambda: imu(
        replace(load_vehicle("copter_default"), accel_cutoff_hz=80.0, gyro_cutoff_hz=60.0)
    ),
    "battery": lambda: battery(load_vehicle("crazyflie")),
}
KINDS = (*COMPONENTS, "replay", "fused")
ALL = [(kind, fmi) for kind in KINDS for fmi in (2, 3)]


@cache
def component(kind: str) -> Component:
    return COMPONENTS[kind]()


@cache
def model(kind: str) -> FmuModel:
    others = {"replay": replay_example, "fused": fused_example}
    return others[kind]() if kind in others else component_model(component(kind))


def recorded(**columns: Iterable[float]) -> Flight:
    """A flight of these columns, `time` among them."""
    return Flight("example", pd.DataFrame({k: np.asarray(v) for k, v in columns.items()}))


def replay_example() -> FmuModel:
    """100 Hz commands, held, and a barometer at a quarter of the rate, interpolated."""
    t = np.arange(200) / 100
    baro = np.where(np.arange(200) % 4 == 0, 101325 - t, np.nan)
    flight = recorded(time=t, cmd_1=0.5 + 0.1 * np.sin(t), baro_pa=baro)
    return replay_model(flight, ("cmd_1", "baro_pa"), linear=("baro_pa",))


def receiver() -> Component:
    """Position fixes that are late, noisy, and come at odd instants."""
    m = ComponentBuilder("receiver", "Position receiver")
    m.sampled(0.0107, "Time between two fixes")
    delay = m.parameter("delay", 0.05, "s", "Age of a fix when it comes", minimum=0)
    noise = m.parameter("noise", 0.0, "m", "Noise of a fix, standard deviation", minimum=0)
    for a in ("x", "y", "z"):
        position = m.input(f"pos_{a}", "m", f"Position, {a}")
        fix = m.memory(f"fix_{a}", "m", f"Last fix, {a}")
        late = m.delayed(f"fix_{a}", position, delay, 10)
        m.update(f"fix_{a}", late + noise * m.noise())
        m.output(f"fix_{a}", "m", f"Last fix, {a}", fix)
    return m.build()


def commands() -> FmuModel:
    """Recorded commands, a straight line between 25 samples a second."""
    t = np.arange(100) / 25
    columns = {f"cmd_{i}": 0.55 + 0.1 * np.sin(5 * t + i) for i in range(1, 5)}
    return replay_model(recorded(time=t, **columns), tuple(columns), linear=tuple(columns))


@cache
def fused_parts() -> dict[str, FmuModel]:
    """Models by name, not in the order of their dependencies."""
    return {
        "imu": model("imu-filtered"),
        "battery": model("battery"),
        "airframe": model("airframe-crazyflie"),
        "receiver": component_model(receiver()),
        "flight": commands(),
    }


def fused_connections() -> list[tuple[str, str]]:
    """From each output to every input of its name, airframe to sensors and back by the battery."""
    parts = fused_parts()
    return [
        (f"{a}.{v.name}", f"{b}.{v.name}")
        for a in ("airframe", "battery", "flight")
        for b in parts
        for v in parts[a].variables
        if v.causality == "output"
        and v.name in {u.name for u in parts[b].variables if u.causality == "input"}
    ]


def fused_example() -> FmuModel:
    """Airframe, battery, sensors and recorded commands in one."""
    return fuse("fused", "Several parts in one", fused_parts(), fused_connections())


class Instance:
    """An FMU behind FMPy; what it says through the logger is in `messages`."""

    def __init__(self, folder: Path) -> None:
        description = fmpy.read_model_description(str(folder))
        self.fmi = 2 if description.fmiVersion.startswith("2") else 3
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.booleans = {v.name for v in description.modelVariables if v.type == "Boolean"}
        self.output_names = [v.name for v in description.modelVariables if v.causality == "output"]
        self.messages: list[str] = []
        self.fmu = (FMU2Slave if self.fmi == 2 else FMU3Slave)(
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

    def start(self, starts: Mapping[str, float] | None = None, time_s: float = 0.0) -> "Instance":
        """Initialise."""
        self.enter(starts, time_s)
        self.leave()
        return self

    def set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            cast = bool if name in self.booleans else float
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
        real = "Real" if self.fmi == 2 else "Float64"
        return getattr(self.fmu, verb + ("Boolean" if name in self.booleans else real))


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
