"""Sudden faults: the journal, the table, and flights of somebody else's simulator."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
import pytest
from places import needs_package
from why_rig import sound

from benchmarks import sudden_faults
from benchmarks.sudden_elsewhere import Flown
from benchmarks.sudden_faults import OWN, Answer, Key, answered, page
from twin.logs import Flight

CHECK = """
import json
from benchmarks.sudden_faults import Answer, sudden_elsewhere
faults = [("rotor_failure", 0.5, 1000), ("mass_change", -0.3, 1000), ("", 0.0, 1001)]
found = [
    Answer.of("drone_models", (*fault, 200.0), flown)
    for fault, flown in zip(faults, sudden_elsewhere.flown(faults, 200.0), strict=True)
]
print(json.dumps([[a.rotor, a.cause, a.named_rotor, a.late_s] for a in found], default=str))
"""


def answer(cause: str, rotor: int | None, *, named: str, named_rotor: int | None) -> Answer:
    return Answer(
        plant=OWN,
        planted=(cause, 0.5, 1000, 200.0),
        begins_s=20.0,
        rotor=rotor,
        cause=named,
        named_rotor=named_rotor,
        onset_s=20.1,
        size=0.45,
        trivial=rotor,
        processor_s=1.0,
        flown_s=30.0,
    )


def test_a_wrong_rotor_is_another_name() -> None:
    rows = page(
        [
            answer("rotor_failure", 2, named="rotor_failure", named_rotor=2),
            answer("rotor_failure", 2, named="rotor_failure", named_rotor=3),
            answer("rotor_failure", 2, named="gust", named_rotor=None),
        ]
    ).splitlines()
    assert rows[-1].split(" | ") == [
        "| own, 200 Hz",
        "rotor failure 0.5",
        "3",
        "2",
        "1",
        "1",
        "2",
        "0.10 s",
        "3 |",
    ]


def test_a_journal_goes_on_where_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[Key] = []

    def quiet(plant: str, keys: Sequence[Key]) -> Iterator[Flown]:
        for key in keys:
            flown.append(key)
            yield Flown(Flight("sound", pd.DataFrame(sound())), float("inf"), None)

    monkeypatch.setattr(sudden_faults, "_flights", quiet)
    keys = [("", 0.0, seed, 50.0) for seed in (1, 2)]
    first = list(answered(OWN, keys[:1], tmp_path / "j"))
    again = list(answered(OWN, keys, tmp_path / "j"))
    assert flown == keys, "each flight is flown once"
    assert again[0] == first[0] and again[1].planted == keys[1]


@pytest.mark.slow
@needs_package("drone_models")
def test_flights_of_drone_models() -> None:
    """Its dynamics become those of a damaged aircraft; rotor, mass and onset are found."""
    run = subprocess.run(
        [sys.executable, "-c", CHECK],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "SCIPY_ARRAY_API": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    loss, mass, nothing = json.loads(run.stdout)
    assert loss[1] == "rotor_failure" and loss[0] == loss[2] and abs(loss[3]) < 0.1
    assert mass[1] == "mass_change" and abs(mass[3]) < 0.1
    assert nothing[1] == ""
