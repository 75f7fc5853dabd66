"""Verbs killed at random moments: nothing half-written, nothing left, and the same command works,
to the same bytes, with two threads as with one. `benchmarks/repeatability.py` kills all verbs.
"""

from pathlib import Path

import pytest
from places import IMPORT_PATH

from benchmarks.repeatability import VERBS, Bench, killed, write_flights


@pytest.mark.slow
@pytest.mark.parametrize("kills", [4, pytest.param(12, marks=pytest.mark.long)])
def test_killed_at_any_moment(kills: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each verb with what was compiled before, and without."""
    monkeypatch.setenv("PYTHONPATH", IMPORT_PATH)
    write_flights(tmp_path)
    bench = Bench(tmp_path, {name: VERBS[name] for name in ("gap", "export")})
    assert list(killed(bench, kills, seed=0, done=lambda _: None)) == []
