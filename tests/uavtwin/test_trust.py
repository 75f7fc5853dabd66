"""`uavtwin simulate` of somebody's `.ssp`: what its FMUs may decide, and what not."""

import hashlib
import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from bad_fmu import bad_fmu
from cli_rig import run

import uavtwin as ut
from cosim.limits import Limits
from cosim.master import RunError
from cosim.ssp import write_ssp
from cosim.system import System
from twin.errors import TwinError
from uavtwin.cli.simulate import simulate as simulate_verb
from uavtwin.run import read_hashes

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def simulate(capfd: pytest.CaptureFixture[str]) -> Call:
    """One call, with what libraries print below Python."""
    return lambda *arguments: run(capfd, "simulate", *arguments)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bad_fmu(tmp_path_factory.mktemp("bad"))


@pytest.fixture(scope="module")
def ssp(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A system of one slave, which misbehaves as its name says."""
    folder = tmp_path_factory.mktemp("ssp")

    def get(kind: str) -> Path:
        return write_ssp(System({kind: fmu}, stop_time_s=1.0, step_s=0.1), folder / f"{kind}.ssp")

    return get


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("exit0", "exit0 (bad.fmu): fmi2DoStep at 0.4 s: its process ended with exit code 0"),
        ("nan", "nan (bad.fmu): y = nan at 0.5 s"),
    ],
)
def test_an_fmu_that_fails(
    ssp: Callable[[str], Path], simulate: Call, tmp_path: Path, kind: str, text: str
) -> None:
    """One error, exit 1, and what was recorded is there and says that it is not all."""
    out = tmp_path / "o"
    code, said, told = simulate(ssp(kind), "--out", out, "--json")
    assert code == 1
    assert told.startswith(f"error: {text}")
    assert told.count("\n") == 1
    assert told.endswith(f"up to 0.4 s is in {out}, marked incomplete.\n")
    assert text in json.loads(said)["incomplete"]
    table = pd.read_parquet(out / "recording.parquet")
    assert table[f"{kind}.y"].tolist() == [0, 1, 2, 3, 4]
    assert text in table.attrs["incomplete"]
    for name in ("run.json", "summary.json"):
        assert text in json.loads((out / name).read_text())["incomplete"]
    assert "INCOMPLETE" in (out / "report.html").read_text()


@pytest.mark.slow
def test_an_fmu_that_prints(ssp: Callable[[str], Path], simulate: Call, tmp_path: Path) -> None:
    code, said, told = simulate(ssp("prints"), "--out", tmp_path / "o", "--json")
    assert (code, json.loads(said), told) == (0, {}, "")
    assert "nonsense" in (tmp_path / "o" / "printed.txt").read_text()
    assert "incomplete" not in json.loads((tmp_path / "o" / "run.json").read_text())


@pytest.mark.slow
def test_an_fmu_that_never_ran(ssp: Callable[[str], Path], simulate: Call, tmp_path: Path) -> None:
    """Nothing was recorded, so nothing is written."""
    code, said, told = simulate(ssp("exit_in_instantiate"), "--out", tmp_path / "o")
    assert (code, said) == (2, "")
    assert told == (
        "error: exit_in_instantiate (bad.fmu): instantiate at 0 s: its process ended with exit "
        "code 0.\n"
    )
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_limits_are_options(ssp: Callable[[str], Path], simulate: Call, tmp_path: Path) -> None:
    limit = ("--call-limit", "2")
    code, _, told = simulate(ssp("loop_in_step"), *limit, "--out", tmp_path / "o")
    assert code == 1
    assert "fmi2DoStep at 0.4 s: did not return within 2 s, the limit (--call-limit)" in told
    code, _, told = simulate(ssp("fine"), "--memory-limit", "0", "--out", tmp_path / "p")
    assert (code, told) == (2, "error: limit memory_gib = 0: needs a positive number.\n")


def test_limits_are_the_same_from_python() -> None:
    """The command line says them itself, so as to load no simulation for other verbs."""
    said = inspect.signature(simulate_verb).parameters
    names = {"call_s": "call_limit", "whole_s": "time_limit", "memory_gib": "memory_limit"}
    assert Limits(**{own: said[option].default for own, option in names.items()}) == Limits()


@pytest.mark.slow
def test_from_python(ssp: Callable[[str], Path]) -> None:
    with pytest.raises(RunError, match="exit code 0") as caught:
        ut.simulate(ssp("exit0"), interval=0.1)
    assert caught.value.recording["exit0.y"].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.slow
def test_an_interrupted_flight_is_kept(tmp_path: Path) -> None:
    """Of our own FMU, in the process: Ctrl-C in a run by the clock."""
    out = tmp_path / "o"
    arguments = ["simulate", "hover", "--fused", "--realtime", "--out", str(out)]
    command = [sys.executable, "-c", _CONTROL_C, *arguments]
    process = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    assert process.returncode == 130
    *progress, told = process.stderr.splitlines()
    assert told.startswith("interrupted at 0.5") and all("simulating: " in p for p in progress)
    table = pd.read_parquet(out / "recording.parquet")
    assert len(table) > 10
    assert table.attrs["incomplete"].startswith("interrupted at 0.5")


_CONTROL_C = """
import os, signal
from cosim.master import Pace
from uavtwin.cli.main import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # under nohup it is ignored
wait = Pace.wait

def later(pace, time_s):
    wait(pace, time_s)
    if time_s > 0.5:
        os.kill(os.getpid(), signal.SIGINT)

Pace.wait = later
main()
"""
"""The command line, with a key pressed half a second after its flight began."""


# -- trust ----------------------------------------------------------------------------------


def _line(path: Path, mark: str = " ") -> str:
    return f"{hashlib.sha256(path.read_bytes()).hexdigest()} {mark}{path.name}\n"


@pytest.mark.slow
def test_trusted_fmus_run_in_this_process(
    ssp: Callable[[str], Path], fmu: Path, simulate: Call, tmp_path: Path
) -> None:
    """The hash of the FMU or of the `.ssp`; such an FMU may print where it likes."""
    for i, path in enumerate((fmu, ssp("prints"))):
        hashes = tmp_path / f"{i}.sha256"
        hashes.write_text(_line(path, "*"))
        arguments = (ssp("prints"), "--trust", hashes, "--out", tmp_path / f"o{i}")
        code, said, _ = simulate(*arguments)
        assert code == 0
        assert "nonsense" in said
        options = json.loads((tmp_path / f"o{i}" / "run.json").read_text())
        assert options["options"]["trust"] == hashes.name
        assert hashes.name in [f["name"] for f in options["inputs"]]


@pytest.mark.slow
def test_an_fmu_that_is_not_named_is_refused(
    ssp: Callable[[str], Path], simulate: Call, tmp_path: Path
) -> None:
    """As one that has changed since."""
    hashes = tmp_path / "other.sha256"
    hashes.write_text(_line(Path(__file__)))
    code, _, told = simulate(ssp("exit0"), "--trust", hashes, "--out", tmp_path / "o")
    assert code == 2
    assert "exit0 (bad.fmu): its sha256" in told
    assert "is not in other.sha256" in told
    assert not (tmp_path / "o").exists()
    code, _, told = simulate("hover", "--trust", hashes, "--out", tmp_path / "o")
    assert code == 2
    assert "scenario hover has no FMUs to trust" in told


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("", "holds no hash"),
        ("0" * 63 + "  a.fmu\n", "line 1 is not of sha256sum"),
        ("0" * 64 + "  a.fmu\n" + "0" * 64 + "\n", "line 2 is not of sha256sum"),
        ("SHA256 (a.fmu) = " + "0" * 64 + "\n", "line 1 is not of sha256sum"),
    ],
)
def test_wrong_files_of_hashes(tmp_path: Path, content: str, text: str) -> None:
    path = tmp_path / "hashes"
    path.write_text(content)
    with pytest.raises(TwinError, match=rf"hashes: {text}"):
        read_hashes(path)
    with pytest.raises(TwinError, match=r"missing: cannot be read"):
        read_hashes(tmp_path / "missing")


@pytest.mark.slow
def test_files_as_sha256sum_writes_them(fmu: Path, tmp_path: Path) -> None:
    said = subprocess.run(["sha256sum", fmu], capture_output=True, text=True, check=True).stdout
    (tmp_path / "hashes").write_text(said)
    assert read_hashes(tmp_path / "hashes") == {hashlib.sha256(fmu.read_bytes()).hexdigest()}
