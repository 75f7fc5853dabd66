"""The speed figures, measured here and now.

Every figure is the best of several runs, but that of the worker process, a quotient of medians;
what is compared runs side by side. libcosim and ecos, two other co-simulation masters, are timed
where they are installed (the extra `test`), each in a process of its own.
"""

import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np

from cosim.master import Master
from cosim.ssp import write_ssp
from cosim.system import Connection, System, connect
from cosim.whole_twin import fused_model, system_of
from cosim.worker import WorkerMaster
from fmus import build, component_model
from fmus.python_slave.build import build_python_slave
from twin.flight.assembly import flying_twin
from twin.physics.airframe import airframe
from twin.physics.residual_force import FEATURES, INPUTS, ForceLaw
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

from .compensator import Row, compensator_rows

STEP_S = 1e-3
"""Communication step of the runs, s."""
REPEATS = 5
"""Repetitions, of which the fastest counts."""
WHOLE_S = 60.0
"""Simulated time of the whole twin, s."""


def run_bench(progress: Callable[[float], None] = lambda _: None) -> list[Row]:
    """Measure; takes about two minutes, most of it compiling where the cache is empty."""
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as name:
        folder = Path(name)
        parts = (_steps, _eight, _whole_twin, compensator_rows)
        for i, part in enumerate(parts):
            rows += part(folder)
            progress((i + 1) / len(parts))
    return rows


def _steps(folder: Path) -> list[Row]:
    """One component, native and as a Python slave."""
    vehicle = load_vehicle("copter_default")
    body, sensor = airframe(vehicle), imu(vehicle)
    native = build(component_model(body), folder / "airframe.fmu")
    pair = System(
        {"airframe": native, "imu": build(component_model(sensor), folder / "imu.fmu")},
        connect("airframe", "imu", sensor.input_names),
    )
    inside = _inside(native, 20.0)
    per_step = _per_step(System({"airframe": native}), 20_000)
    both = _per_step(pair, 20_000) / 2
    python = build_python_slave(body, folder / "python.fmu")
    python_inside = _inside(python, 1.0)
    python_per_step = _per_step(System({"airframe": python}), 1_000)
    return [
        Row("airframe, one 1 ms step inside the native FMU", inside, "us", "<= 0.5"),
        Row("the same inside a Python slave (pythonfmu)", python_inside, "us", ""),
        Row("native faster by", python_inside / inside, "x", ">= 50"),
        Row("airframe, one doStep through the master", per_step, "us", "<= 5"),
        Row("airframe and IMU, per FMU and doStep through the master", both, "us", "<= 5"),
        Row("Python slave, one doStep through the master", python_per_step, "us", ""),
        Row("native faster by", python_per_step / per_step, "x", ">= 10"),
    ]


def _eight(folder: Path) -> list[Row]:
    """Four airframes with an IMU each, stepped at 1 kHz."""
    vehicle = load_vehicle("copter_default")
    sensor = imu(vehicle)
    fmus: dict[str, Path] = {}
    connections: list[Connection] = []
    for i in range(4):
        fmus[f"airframe{i}"] = build(component_model(airframe(vehicle)), folder / f"body{i}.fmu")
        fmus[f"imu{i}"] = build(component_model(sensor), folder / f"sensor{i}.fmu")
        connections += connect(f"airframe{i}", f"imu{i}", sensor.input_names)
    system = System(fmus, tuple(connections), stop_time_s=20.0, step_s=STEP_S)
    ours = _per_step(system, 20_000)
    rows = [Row("eight FMUs, one 1 ms step of the master", ours, "us", "<= 25")]
    ssp = write_ssp(system, folder / "eight.ssp")
    return rows + [
        Row(f"the same with {name}", s / 20_000 * 1e6, "us", "") for name, s in _others(ssp, 20.0)
    ]


def _whole_twin(folder: Path) -> list[Row]:
    """60 s of the whole twin: fused into one FMU, and as one FMU per part."""
    vehicle = load_vehicle("crazyflie")
    assembly = flying_twin(vehicle, "tour")
    whole = build(fused_model(assembly, "crazyflie"), folder / "fused.fmu")
    fused = _through_fmpy(whole)
    apart = _apart(System({"twin": whole}))
    with_law = flying_twin(vehicle, "tour", law=_linear_law())
    taught = _through_fmpy(build(fused_model(with_law, "crazyflie"), folder / "taught.fmu"))
    both = [(_best(fused, 1), _best(taught, 1)) for _ in range(REPEATS)]
    one, law = (min(times) for times in zip(*both, strict=True))
    system = system_of(assembly, folder)
    with Master(system, record=["airframe.pos_x"]) as master:

        def stepped() -> None:
            """One run of the parts."""
            master.initialize()
            master.run(WHOLE_S, STEP_S, every=10)

        parts = _best(stepped)
    others = _others(write_ssp(system, folder / "parts.ssp"), WHOLE_S)
    return [
        Row("whole twin fused, 60 s at 1 kHz through FMPy, 10 ms steps", one, "s", "<= 0.2"),
        Row("the same with a linear law of force and moment, longer by", law / one - 1, "", "0.05"),
        Row("the same as one FMU per part, our master", parts, "s", ""),
        *(Row(f"the same as one FMU per part, {name}", s, "s", "") for name, s in others),
        Row("fused faster than our master by", parts / one, "x", ">= 10"),
        *(Row(f"fused faster than {name} by", s / one, "x", "") for name, s in others),
        Row("fused, 1 ms steps of our master, longer in a process of its own by", apart, "", "0.1"),
    ]


def _apart(system: System) -> float:
    """Share by which runs at 1 kHz take longer in a worker process that runs already.

    Many short ones in turn: a machine with neighbours changes its pace within a long one."""
    with Master(system) as here, WorkerMaster(system) as there:

        def seconds(master: Master | WorkerMaster) -> float:
            """One run, all outputs recorded every 10 ms."""
            master.initialize()
            begin = time.perf_counter()
            master.run(WHOLE_S, STEP_S, every=10)
            return time.perf_counter() - begin

        pairs = [(seconds(here), seconds(there)) for _ in range(8 * REPEATS)]
    inside, outside = (statistics.median(each) for each in zip(*pairs, strict=True))
    return float(outside / inside - 1)


def _through_fmpy(fmu: Path) -> Callable[[], None]:
    """One run with 10 ms communication steps, the position recorded."""
    description = fmpy.read_model_description(str(fmu))
    unzipped = fmpy.extract(str(fmu), str(fmu.with_suffix("")))

    def run() -> None:
        """From start to end."""
        fmpy.simulate_fmu(
            unzipped,
            model_description=description,
            stop_time=WHOLE_S,
            output_interval=0.01,
            output=[f"airframe.pos_{a}" for a in "xyz"],
        )

    return run


def _linear_law() -> ForceLaw:
    """A law with a small weight of every feature: what it says does not matter, what it costs
    does."""
    d = len(INPUTS)
    return ForceLaw(
        linear=np.full((6, len(FEATURES)), 1e-9),
        centre=np.zeros(d),
        scale=np.ones(d),
        whitening=np.tri(d),
        reach=1e3,
        most=np.ones(6),
        units=np.eye(6),
    )


def _best(run: Callable[[], None], repeats: int = REPEATS) -> float:
    """Seconds of the fastest of several runs."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


_LIBCOSIM = """
import sys, time
from libcosimpy.CosimExecution import CosimExecution
execution = CosimExecution.from_ssp_file(sys.argv[1])
begin = time.perf_counter()
execution.simulate_until(target_time=round(float(sys.argv[2]) * 1e9))
print("seconds", time.perf_counter() - begin, flush=True)
"""
"""Script that runs the twin by libcosim."""
_ECOS = """
import sys, time
from ecospy import EcosSimulation
simulation = EcosSimulation(1e-3, ssp_path=sys.argv[1])
simulation.init(parameter_set="initialValues")
begin = time.perf_counter()
simulation.step(round(float(sys.argv[2]) / 1e-3))
print("seconds", time.perf_counter() - begin, flush=True)
"""
"""Script that runs the twin by Ecos."""


def _others(ssp: Path, duration_s: float) -> list[tuple[str, float]]:
    """Name and seconds of the other masters that are installed and run the system."""
    found = []
    for name, script in (("libcosim", _LIBCOSIM), ("ecos", _ECOS)):
        command = [sys.executable, "-c", script, str(ssp), str(duration_s)]
        times = []
        for _ in range(REPEATS):
            result = subprocess.run(command, capture_output=True, text=True, check=False)
            times += re.findall(r"^seconds (\S+)$", result.stdout, re.MULTILINE)
        if times:
            found.append((name, min(map(float, times))))
    return found


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
