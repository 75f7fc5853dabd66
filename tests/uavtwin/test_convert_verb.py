"""`uavtwin convert`: any log to a flight table, the same flight in it."""

import json
from pathlib import Path

import pandas as pd
import pytest
from cli_rig import run
from log_rigs.dataflash_rig import dataflash
from sample_logs import FLOWN_PARAMS, SAMPLES, flown_messages

from twin.errors import LogError
from twin.logs import read_flight
from twin.logs.flight import Notes
from twin.logs.table import noted


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(flown_messages() | {"RCOU": {"t": [0.0]}}, FLOWN_PARAMS))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_the_table_is_the_flight(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path, ending: str
) -> None:
    out = tmp_path / "tables" / f"flight.{ending}"
    code, said, _ = run(capsys, "convert", log, "--out", out)
    assert code == 0 and f"written: {out}" in said and "ArduPilot DataFlash, 30.0 s" in said
    before, after = read_flight(log), read_flight(out)
    pd.testing.assert_frame_equal(before.table, after.table, rtol=1e-12, check_dtype=False)
    if ending == "parquet":
        kept = {k: v for k, v in before.facts.items() if k != "format"}
        assert kept.items() <= after.facts.items()
        assert set(before.findings) <= set(after.findings)
        assert before.airframe is not None and before.airframe.layout is not None
        about = [noted(Notes(site=f.site, airframe=f.airframe)) for f in (before, after)]
        assert about[0] == about[1]
    record = json.loads((out.parent / "flight.run.json").read_text())
    assert record["verb"] == "convert" and record["inputs"][0]["name"] == "flight.bin"


def test_an_mcap_of_ours_is_no_log(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    out = tmp_path / "flight.mcap"
    code, _, said = run(capsys, "convert", log, "--out", out)
    assert code == 0, said
    with pytest.raises(LogError, match=r"flight.mcap: an MCAP that uavtwin wrote, .* give the log"):
        read_flight(out)


def test_a_file_that_is_there_stays(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, log: Path
) -> None:
    out = tmp_path / "flight.csv"
    out.write_text("mine")
    code, _, said = run(capsys, "convert", log, "--out", out)
    assert code == 2 and "add --force" in said and out.read_text() == "mine"
    code, _, _ = run(capsys, "convert", log, "--out", out, "--force")
    assert code == 0 and out.read_text().startswith("time,")


@pytest.mark.parametrize("name", ["flight.mat", "flight", "flight.bag"])
def test_another_ending_is_refused_before_the_log_is_read(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str
) -> None:
    code, _, said = run(capsys, "convert", tmp_path / "none.bin", "--out", tmp_path / name)
    assert code == 2 and ".parquet, .csv, .mcap" in said


def test_findings_of_kind_error_give_exit_code_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "cut.ulg"
    path.write_bytes(SAMPLES["PX4 ULog"]()[:-5])
    code, _, said = run(capsys, "convert", path, "--out", tmp_path / "cut.parquet")
    assert code == 1 and "cut short" in said
    assert (tmp_path / "cut.parquet").exists()
