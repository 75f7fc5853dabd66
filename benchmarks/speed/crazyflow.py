"""Steps per second of one core, many aircraft at once: ours in lanes against crazyflow.

    python -m benchmarks.speed.crazyflow --python PYTHON --out FILE [--runs 64,512,4096]

crazyflow (the Python package of that name) is a simulator of many quadrotors in JAX. PYTHON is
the interpreter of an environment with `pip install crazyflow`; without it ours alone is measured.
All is pinned to one core and counted in processor time. FILE has a line for each measurement; what
stands there is not measured anew.

Ours makes steps of 1 ms by the classical method of fourth order in double precision: mission,
controller, wind, airframe, ground and battery of the built-in Crazyflie over its tour of 20 s, with
its sensors and their noise and without. Theirs makes steps of 2 ms of a Crazyflie that hovers, with
its position controller at 100 Hz and its attitude controller at 500 Hz.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from cosim.lanes import LaneMaster
from cosim.system import System
from cosim.whole_twin import fused_model
from fmus import build
from twin.flight.assembly import SENSED, Assembly, flying_twin
from twin.vehicle_file import load_vehicle
from uavtwin.cli.printing import print_table
from uavtwin.display import TextTable

VEHICLE = "crazyflie"
DURATION_S, STEP_S = 20.0, 1e-3
ROUNDS = 3
"""Measurements of each in turn, of which the fastest counts."""
OURS = ("without sensors", "with sensors")
THEIRS = {
    "Euler, single": ("euler", "0"),
    "Euler, double": ("euler", "1"),
    "Runge-Kutta, double": ("rk4", "1"),
}
"""Their method, and whether JAX computes in double precision; they begin with what they choose."""
_CRAZYFLOW = """
import sys, time
import jax.numpy as jnp
from crazyflow.sim import Sim
runs, method, steps = int(sys.argv[1]), sys.argv[2], 100
sim = Sim(n_worlds=runs, control="state", integrator=method)
sim.reset()
sim.state_control(jnp.zeros((runs, 1, 16)).at[..., 2].set(1.0).at[..., 12].set(1.0))
def timed():
    begin = time.process_time()
    sim.step(steps)
    sim.data.states.pos.block_until_ready()
    return time.process_time() - begin
timed()
fastest = min(timed() for _ in range(10))
while sim.data.core.steps.max() < 1500:
    sim.step(steps)
height = float(sim.data.states.pos[..., 2].mean())
assert 0.8 < height < 1.2, f"it does not hover: {height} m"
print("per second", runs * steps / fastest)
"""
"""Script that flies crazyflow's aircraft and says how many steps a second makes."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--python", help="interpreter that has crazyflow")
    parser.add_argument("--out", type=Path, required=True, help="JSON lines of the measurements")
    parser.add_argument("--runs", default="64,512,4096", help="aircraft at once")
    given = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    theirs = list(THEIRS) if given.python else []
    if not given.python:
        print("crazyflow is not measured: pip install crazyflow, elsewhere, and --python PYTHON")
    done = (
        [json.loads(row) for row in given.out.read_text().splitlines()]
        if given.out.exists()
        else []
    )
    runs = [int(text) for text in given.runs.split(",")]
    with tempfile.TemporaryDirectory(prefix="uavtwin-") as folder:
        masters = dict(_masters(Path(folder)))
        for turn, n, what in (
            (r, n, w) for r in range(ROUNDS) for n in runs for w in (*OURS, *theirs)
        ):
            key = {"round": turn, "runs": n, "what": what}
            if any(key.items() <= row.items() for row in done):
                continue
            ours = what in OURS
            made = _ours(masters[what], n) if ours else _theirs(given.python, n, what, folder)
            done.append(key | {"steps_per_s": made})
            with given.out.open("a") as file:
                file.write(json.dumps(done[-1]) + "\n")
    print_table(_table(done, runs, [*OURS, *theirs]))


def _masters(folder: Path) -> Iterator[tuple[str, LaneMaster]]:
    """Of ours, by what they fly."""
    whole = flying_twin(load_vehicle(VEHICLE), "tour")
    for name, assembly in zip(OURS, (_without_sensors(whole), whole), strict=True):
        fmu = build(fused_model(assembly, VEHICLE), folder / f"{name.replace(' ', '_')}.fmu")
        yield name, LaneMaster(System({"twin": fmu}), record=["twin.airframe.pos_z"])


def _without_sensors(assembly: Assembly) -> Assembly:
    parts = {name: part for name, part in assembly.parts.items() if name not in SENSED}
    left = tuple(w for w in assembly.connections if all(e.split(".")[0] in parts for e in w))
    return replace(assembly, parts=parts, connections=left)


def _ours(master: LaneMaster, runs: int) -> float:
    """Steps per second of the processor."""
    steps = round(DURATION_S / STEP_S)
    masses = [0.025 + 0.005 * k / runs for k in range(runs)]
    starts = [{"twin.airframe.mass": mass} for mass in masses]
    begin = time.process_time()
    for first in range(0, runs, master.lanes):
        master.run(starts[first : first + master.lanes], 0.0, DURATION_S, STEP_S, every=steps)
    return runs * steps / (time.process_time() - begin)


def _theirs(python: str, runs: int, what: str, folder: str) -> float:
    """Steps per second of the processor.

    Args:
        python: Interpreter.
        runs: Aircraft at once.
        what: Of `THEIRS`.
        folder: Where MuJoCo writes its log.

    Raises:
        SystemExit: It does not run.
    """
    method, double = THEIRS[what]
    result = subprocess.run(
        [python, "-c", _CRAZYFLOW, str(runs), method],
        env={**os.environ, "JAX_ENABLE_X64": double, "JAX_PLATFORMS": "cpu"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    said = [row for row in result.stdout.splitlines() if row.startswith("per second ")]
    if result.returncode or not said:
        raise SystemExit(f"{python}: crazyflow does not run:\n{result.stderr[-600:]}")
    return float(said[-1].split()[-1])


def _table(done: list[dict[str, Any]], runs: list[int], names: list[str]) -> TextTable:
    """Millions of steps per second, and ours over each of theirs."""
    found = {
        (n, w): max(d["steps_per_s"] for d in done if (d["runs"], d["what"]) == (n, w))
        for n in runs
        for w in names
    }
    header = ("aircraft", *(f"{w}, 1e6 steps/s" for w in names))
    rows = [(str(n), *(f"{found[n, w] / 1e6:.2f}" for w in names)) for n in runs]
    best = {w: max(found[n, w] for n in runs) for w in names}
    for ours in OURS:
        ratios = ("" if w in OURS else f"{best[ours] / best[w]:.2f}" for w in names)
        rows.append((f"ours {ours} over it, best", *ratios))
    return TextTable(header, tuple(rows))


if __name__ == "__main__":
    main()
