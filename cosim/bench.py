"""`uavtwin bench`: the speed figures of the README, measured here and now.

Every figure is the best of several runs, native FMU and Python slave of the same component side by
side in one process.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fmus import build, component_model
from fmus.python_slave import build_python_slave
from twin.airframe import airframe
from twin.imu import imu
from twin.vehicle_file import load_vehicle

from .master import Master
from .system import System, connect

STEP_S = 1e-3
REPEATS = 5


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure."""

    what: str
    value: float
    unit: str
    goal: str

    def as_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def run_bench(progress: Callable[[float], None] = lambda _: None) -> list[Row]:
    """Measure; takes about half a minute."""
    vehicle = load_vehicle("copter_default")
    body, sensor = airframe(vehicle), imu(vehicle)
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name:
        folder = Path(name)
        native = build(component_model(body), folder / "airframe.fmu")
        pair = System(
            {"airframe": native, "imu": build(component_model(sensor), folder / "imu.fmu")},
            connect("airframe", "imu", sensor.input_names),
        )
        inside = _inside(native, 20.0)
        progress(0.2)
        per_step = _per_step(System({"airframe": native}), 20_000)
        progress(0.4)
        both = _per_step(pair, 20_000) / 2
        progress(0.6)
        python = build_python_slave(body, folder / "python.fmu")
        python_inside = _inside(python, 1.0)
        progress(0.8)
        python_per_step = _per_step(System({"airframe": python}), 1_000)
        progress(1.0)
    return [
        Row("airframe, one 1 ms step inside the native FMU", inside, "us", "<= 0.5"),
        Row("the same inside a Python slave (pythonfmu)", python_inside, "us", ""),
        Row("native faster by", python_inside / inside, "x", ">= 50"),
        Row("airframe, one doStep through the master", per_step, "us", "<= 5"),
        Row("airframe and IMU, per FMU and doStep through the master", both, "us", "<= 5"),
        Row("Python slave, one doStep through the master", python_per_step, "us", ""),
        Row("native faster by", python_per_step / per_step, "x", ">= 10"),
    ]


def _inside(fmu: Path, duration_s: float) -> float:
    """Microseconds per internal 1 ms step: one long communication step has no call overhead."""
    steps = round(duration_s / STEP_S)
    best = float("inf")
    with Master(System({"airframe": fmu}), record=[]) as master:
        for _ in range(REPEATS):
            master.initialize()
            begin = time.perf_counter()
            master.run(duration_s, duration_s)
            best = min(best, time.perf_counter() - begin)
    return best / steps * 1e6


def _per_step(system: System, steps: int) -> float:
    """Microseconds per 1 ms communication step of the whole system, all outputs recorded."""
    best = float("inf")
    with Master(system) as master:
        for _ in range(REPEATS):
            master.initialize()
            begin = time.perf_counter()
            master.run(steps * STEP_S, STEP_S)
            best = min(best, time.perf_counter() - begin)
    return best / steps * 1e6
