"""Coverage of bands as its command prints it, on simulated flights of which one is off."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import band_coverage
from twin.logs import write_flight
from uavtwin.demo.flights import fly
from uavtwin.vehicles import load_vehicle

COPTER = load_vehicle("copter_default")


@pytest.mark.slow
def test_bands_hold_flights_of_the_twin_and_not_one_with_more_drag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dragged = replace(COPTER, drag_linear_n_s_m=COPTER.drag_linear_n_s_m + 1.0)
    paths = [tmp_path / f"day_{k}.parquet" for k in range(3)]
    for k, path in enumerate(paths):
        write_flight(fly(COPTER, dragged if k == 2 else COPTER, k, path.stem), path)

    def judged(*words: str | Path) -> list[tuple[str, str, str]]:
        """Day, windows and share of the velocity."""
        monkeypatch.setattr(sys, "argv", ["band_coverage", *map(str, words)])
        band_coverage.main()
        said = capsys.readouterr().out
        return re.findall(r"velocity +day_(\d) +\d+ +(\d+) +([\d.]+)$", said, re.MULTILINE)

    shares = judged("--vehicle", "copter_default", *paths)
    for day, windows, share in shares:
        assert int(windows) > 50
        assert float(share) > 0.85 if day != "2" else float(share) < 0.8, day
    assert len(shares) == 6
    own = dragged.save(tmp_path / "dragged.toml")
    by = [word for path in paths[:2] for word in ("--by", f"{path}=copter_default")]
    for day, windows, share in (found := judged("--vehicle", own, *by, paths[2])):
        assert (day, int(windows) > 50, float(share) > 0.85) == ("2", True, True)
    assert len(found) == 2
