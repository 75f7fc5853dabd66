"""Sudden faults: the journal, the tables, and flights of other people's simulators."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from places import needs_package
from why_rig import sound

from benchmarks.sudden_faults import __main__ as command
from benchmarks.sudden_faults.answers import Answer, by_kind
from benchmarks.sudden_faults.flights import Flown, Key
from benchmarks.sudden_faults.kinds import KINDS, NOTHING, Fault
from benchmarks.sudden_faults.rotorpy import hummingbird, hummingbird_dynamics
from twin.logs import Flight

CHECK = """
from time import process_time
from benchmarks.sudden_faults.answers import Answer
from benchmarks.sudden_faults.flights import Key, flown
keys = [Key("drone_models", k, s, 1, 200.0) for k, s in (("propeller", 0.6), ("load lost", -0.3))]
for key, flight in flown(keys):
    a = Answer.of(key, flight, process_time)
    assert a.right and a.close and set(a.named) == set(a.rotors), a
    assert abs(a.onset_s - a.begins_s) < 0.1, a
"""


def answer(rotors: tuple[int, ...], named: tuple[int, ...], cause: str = "rotor_failure") -> Answer:
    return Answer(
        plant="own",
        planted=("propeller", 0.3, 1000, 200.0),
        begins_s=15.0,
        rotors=rotors,
        cause=cause,
        named=named,
        onset_s=15.1,
        size=(0.2, 0.28, 0.33),
        probability=0.95,
        trivial=rotors[0],
    )


def test_a_wrong_rotor_is_another_name() -> None:
    answers = [answer((2,), (2,)), answer((2,), (3,)), answer((2,), (), "gust")]
    row = by_kind(answers).splitlines()[2].strip("| ").split(" | ")
    assert row == [
        "propeller 0.3",
        *("3", "2 of 3", "1 of 3", "2 of 2", "2 of 2", "0.10 s", "2", "2", "3 of 3"),
    ]


def test_a_journal_goes_on_where_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Key] = []

    def quiet(keys: Sequence[Key]) -> Iterator[tuple[Key, Flown]]:
        for key in keys:
            seen.append(key)
            yield key, Flown(Flight("sound", pd.DataFrame(sound())), float("inf"), ())

    monkeypatch.setattr(command, "flown", quiet)
    keys = [Key("own", "", 0.0, seed, 50.0) for seed in (1, 2)]
    first = list(command.answered(keys[:1], tmp_path / "j"))
    again = list(command.answered(keys, tmp_path / "j"))
    assert seen == keys, "each flight is flown once"
    assert again[0] == first[0] and again[1].planted[2] == 2


def test_every_kind_changes_something_and_nothing_does_not() -> None:
    """Parameters, a push, a gust, a bias, or commands that are cut."""
    sound_one = hummingbird().nominal
    toward = np.array([1.0, 0.0, 0.0])
    for name, kind in (*KINDS.items(), ("nothing", NOTHING)):
        fault = Fault(kind, kind.sizes[1], (0, 1)[: kind.rotors], 15.0, toward, sound_one)
        changes = [
            fault.after is not sound_one,
            bool(fault.push.any()),
            bool(fault.blow(15.0).any()),
            any(fault.bias(k).any() for k in ("gyroscope", "accelerometer", "compass")),
            name == "commands cut",
        ]
        assert sum(changes) == (name != "nothing"), name


def test_a_loss_that_grows_is_there_after_its_time() -> None:
    kind = KINDS["fading rotor"]
    fault = Fault(kind, 0.4, (0,), 15.0, np.zeros(3), hummingbird().nominal)
    assert [fault.share(t) for t in (14.9, 16.0, 17.0, 20.0)] == [0.0, 0.5, 1.0, 1.0]


@needs_package("rotorpy")
def test_the_hummingbird_hovers_at_its_hover_speed() -> None:
    """Force is its weight upward, and no moment is left; a rotor with less thrust turns it away."""
    from benchmarks.hidden_effects.plants.own.parameters import GRAVITY_M_S2, Batch
    from benchmarks.hidden_effects.plants.own.physics import Instant

    nominal = hummingbird().nominal
    weak = KINDS["propeller"].body(nominal, 0.3, (0,))
    still, level = np.zeros((3, 2)), np.repeat(np.eye(3)[:, :, None], 2, axis=2)
    up, q = np.array([[0.0], [0.0], [-10.0]]) * np.ones(2), np.eye(4)[:, :1] * np.ones(2)
    speed = nominal.hover_speed * np.ones((4, 2))
    now = Instant(up, still, still, q, level, still, speed, speed, 0.5 * np.ones((4, 2)), 0.0)
    force, turn = hummingbird_dynamics(Batch([nominal, weak]), now)
    weight = float(nominal.mass) * GRAVITY_M_S2
    assert force[:, 0] == pytest.approx([0.0, 0.0, -weight], rel=1e-6, abs=1e-9)
    assert turn[:, 0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert force[2, 1] == pytest.approx(-weight * (1 - 0.3 / 4), rel=1e-6)
    away = np.cross(nominal.hubs[0], [0.0, 0.0, 0.3 * weight / 4])
    assert turn[:2, 1] == pytest.approx((away / nominal.inertia)[:2], rel=1e-6)


@pytest.mark.slow
@needs_package("drone_models")
def test_flights_of_drone_models() -> None:
    """Its dynamics become those of a damaged aircraft; rotor, mass, sizes and onsets are found."""
    run = subprocess.run(
        [sys.executable, "-c", CHECK],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "SCIPY_ARRAY_API": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
