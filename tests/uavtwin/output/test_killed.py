"""Verbs killed at random moments: nothing half-written, nothing left, files of the user as they
were, and the same command works, to the same bytes, with two threads as with one.
"""

from pathlib import Path

import pytest
from places import IMPORT_PATH

from benchmarks.repeatability import VERBS, Bench, killed, write_flights, write_models

QUICK = ("gap", "export", "convert")
"""One of each way to write: into an empty folder, a new one, beside files of the user. A killed
sweep has tests of its own."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kills", "verbs"), [(4, QUICK), pytest.param(56, tuple(VERBS), marks=pytest.mark.long)]
)
def test_killed_at_any_moment(
    kills: int, verbs: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each verb with what was compiled before, and without."""
    monkeypatch.setenv("PYTHONPATH", IMPORT_PATH)
    write_flights(tmp_path)
    write_models(tmp_path, verbs)
    bench = Bench(tmp_path, {name: VERBS[name] for name in verbs})
    assert list(killed(bench, kills, seed=0, done=lambda _: None)) == []
