"""FMUs after the Reference FMUs in our master and in FMPy: differences are printed (pytest -s)."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from numpy.typing import NDArray
from reference_fmu import ARRAYS, MODELS, reference_fmu

from cosim.master import Master, RunError
from cosim.system import Connection, System
from cosim.worker import WorkerMaster
from twin.errors import FmuError

ALL = [(m, fmi) for m in MODELS for fmi in (2, 3) if fmi == 3 or m not in ARRAYS]
Made = Callable[[str, int], Path]
STARTS = {"a_in": 1.5, "b_in": -2.25, "n_in": 7.0, "flag_in": 1.0, "option_in": 2.0}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("reference")
    return cache(lambda model, fmi: reference_fmu(model, fmi, folder))


def by_fmpy(path: Path, model: str, starts: dict[str, float]) -> NDArray[np.void]:
    step_s, stop_s, _ = MODELS[model]
    values = {k: bool(v) if k == "flag_in" else v for k, v in starts.items()}
    found: NDArray[np.void] = fmpy.simulate_fmu(
        str(path),
        fmi_type="CoSimulation",
        stop_time=stop_s,
        output_interval=step_s,
        start_values=values,
    )
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("model", "fmi"), ALL)
def test_descriptions_are_valid(made: Made, model: str, fmi: int) -> None:
    assert validate_fmu(str(made(model, fmi))) == []


@pytest.mark.slow
@pytest.mark.parametrize(("model", "fmi"), [a for a in ALL if a[0] not in ARRAYS])
def test_our_master_and_fmpy(made: Made, model: str, fmi: int) -> None:
    """The same bits over the default experiment, the stop time told to both."""
    path, (step_s, stop_s, _) = made(model, fmi), MODELS[model]
    starts = STARTS if model == "FEEDTHROUGH" else {}
    theirs = by_fmpy(path, model, starts)
    with WorkerMaster(
        System({"one": path}, starts={f"one.{k}": v for k, v in starts.items()})
    ) as m:
        m.initialize(stop_time_s=stop_s)
        try:
            ours = m.run(stop_s, step_s)
        except RunError as error:
            assert model == "STAIR" and "asked to end the simulation at 10 s" in str(error)
            ours = error.recording
    n = len(ours.time_s)
    assert n == len(theirs) - (model == "STAIR")  # FMPy keeps the row at which it was asked to end
    differences = {
        name: float(np.max(np.abs(ours[f"one.{name}"] - theirs[name][:n].astype(float))))
        for name in (theirs.dtype.names or ())[1:]
    }
    print(f"{model}, FMI {fmi}: {n} rows, largest differences {differences}")
    assert max(differences.values()) == 0.0
    np.testing.assert_allclose(ours.time_s, theirs["time"][:n], atol=1e-9)


@pytest.mark.parametrize("fmi", [2, 3])
def test_exact_solutions(made: Made, fmi: int) -> None:
    """x = (1 - k h)^n of Euler's method; a ball that loses energy; a file that was read."""
    with Master(System({"x": made("DAHLQUIST", fmi), "y": made("RESOURCE", fmi)})) as m:
        m.initialize(stop_time_s=2.0)
        run = m.run(2.0, 0.1)
    np.testing.assert_allclose(run["x.x"], 0.9 ** np.arange(21), rtol=1e-14)
    assert set(run["y.y"]) == {float(ord("a"))}
    with Master(System({"b": made("BOUNCING_BALL", fmi)})) as m:
        m.initialize(stop_time_s=3.0)
        run = m.run(3.0, 0.01)
    energy = 9.81 * run["b.h"] + run["b.v"] ** 2 / 2
    assert run["b.h"].min() == 0.0 and energy[-1] < 0.05 * energy[0]


@pytest.mark.parametrize("fmi", [2, 3])
def test_scalars_of_all_types_pass_through_two(made: Made, fmi: int) -> None:
    path = made("FEEDTHROUGH", fmi)
    wires = tuple(Connection(f"a.{n[:-3]}_out", f"b.{n}") for n in STARTS)
    with Master(
        System({"a": path, "b": path}, wires, {f"a.{k}": v for k, v in STARTS.items()})
    ) as m:
        m.initialize()
        run = m.run(0.2, 0.1, "settled")
    for name, value in STARTS.items():
        assert set(run[f"b.{name[:-3]}_out"]) == {value}


def test_arrays_are_refused_by_name(made: Made) -> None:
    """FMPy runs it: y of its first row is D u."""
    path = made("STATE_SPACE", 3)
    np.testing.assert_allclose(by_fmpy(path, "STATE_SPACE", {})["y"][0], [0.0, 1.0, 3.0])
    with pytest.raises(FmuError, match=r"y is an array of Float64; only Real, Integer"):
        Master(System({"a": path}), ["a.y"])
