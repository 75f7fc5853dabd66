"""Coverage of bands as its command prints it, on simulated flights of which one is off."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import band_coverage
from twin.logs import write_flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import fly

COPTER = load_vehicle("copter_default")


@pytest.mark.slow
def test_bands_hold_flights_of_the_twin_and_not_one_with_more_drag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dragged = replace(COPTER, drag_linear_n_s_m=COPTER.drag_linear_n_s_m + 1.0)
    paths = [tmp_path / f"day_{k}.parquet" for k in range(3)]
    for k, path in enumerate(paths):
        write_flight(fly(COPTER, dragged if k == 2 else COPTER, k, path.stem), path)
    asked = ["band_coverage", "--vehicle", "copter_default", *map(str, paths)]
    monkeypatch.setattr(sys, "argv", asked)
    band_coverage.main()
    said = capsys.readouterr().out
    shares = re.findall(r"velocity +day_(\d) +\d+ +(\d+) +([\d.]+)$", said, re.MULTILINE)
    for day, windows, share in shares:
        assert int(windows) > 50
        assert float(share) > 0.85 if day != "2" else float(share) < 0.8, day
    assert len(shares) == 6
