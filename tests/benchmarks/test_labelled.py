"""Labelled flights of others: index, methods, figures, page."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from why_rig import sound

from benchmarks.labelled import methods
from benchmarks.labelled.flights import CLASSES, INDEX, NORMAL, Labelled, class_of, labelled, opened
from benchmarks.labelled.instruments import Outcome
from benchmarks.labelled.methods import METHODS, Answer, Asked
from benchmarks.labelled.page import (
    BEGIN,
    END,
    flight_rows,
    tables,
    write_between,
    write_flights,
)
from benchmarks.labelled.score import Said, calibration_error, score
from twin.errors import TwinError
from twin.logs import Flight, write_flight
from twin.why.flight import FlightFrame

FLIGHT = Labelled("a.parquet", "own", "", "", "", "", "", NORMAL, frozenset(), None, ())


def asked(table: dict[str, np.ndarray], references: tuple[Flight, ...] = ()) -> Asked:
    flight = Flight("flight", pd.DataFrame(table))
    return Asked(flight, FlightFrame.of(flight), references, Path("flight.parquet"))


def test_the_index_names_origin_licence_and_bytes_of_each_file() -> None:
    rows = labelled()
    assert len(rows) == len({r.file for r in rows}) >= 50
    for r in rows:
        assert r.label in {*CLASSES, NORMAL}
        assert len(r.sha256) == 64 and r.repository and r.licence
        assert (r.onset_s is None) == (r.label != "rotor_failure")
    with INDEX.open(encoding="utf-8") as file:
        assert next(csv.DictReader(file)).keys() >= {"repository", "commit", "path", "sha256"}


def test_other_bytes_are_refused_and_missing_files_left_out(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    assert list(opened([FLIGHT], tmp_path)) == []
    write_flight(Flight("a", pd.DataFrame(sound())), file)
    with pytest.raises(TwinError, match="sha256"):
        list(opened([FLIGHT], tmp_path))
    import hashlib

    right = replace(FLIGHT, sha256=hashlib.sha256(file.read_bytes()).hexdigest())
    ((_, flight),) = opened([right], tmp_path)
    assert len(flight.table) == len(sound()["time"])


def test_causes_of_a_class_are_its_own() -> None:
    assert class_of("rotor_efficiency_loss") == "propeller"
    assert class_of("gyro_bias") == "other"


def _steered(fails_s: float = np.inf) -> dict[str, np.ndarray]:
    """A body whose rates follow its commands until a rotor stops."""
    rng = np.random.default_rng(4)
    table = sound()
    t = table["time"]
    roll, pitch, yaw = (
        0.05 * np.sin(w * t) + 0.01 * rng.standard_normal(len(t)) for w in (3, 2, 1)
    )
    signs = ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))
    for i, (a, b, c) in enumerate(signs):
        table[f"cmd_{i + 1}"] = 0.5 + a * roll + b * pitch + c * yaw
    torque = np.stack([4 * roll, 4 * pitch, 2 * yaw], axis=1)
    torque[t > fails_s, 0] += 20.0
    rates = np.zeros_like(torque)
    for k in range(1, len(t)):
        rates[k] = 0.95 * rates[k - 1] + 0.05 * torque[k - 1]
    for column, values in zip(("gyro_x", "gyro_y", "gyro_z"), rates.T, strict=True):
        table[column] = values + 1e-3 * rng.standard_normal(len(t))
    return table


def test_recursive_least_squares_detects_what_does_not_follow_the_commands() -> None:
    calm = methods.recursive_least_squares(asked(_steered()))
    assert calm is not None and calm.label == NORMAL
    failed = methods.recursive_least_squares(asked(_steered(30.0)))
    assert failed is not None and failed.label == "rotor_failure"
    assert failed.onset_s == pytest.approx(30.0, abs=0.15)


def test_the_current_residual_needs_a_second_beyond(monkeypatch: pytest.MonkeyPatch) -> None:
    table = sound()
    t = table["time"]

    def current(stops_s: float, ends_s: float) -> Answer | None:
        amps = np.full((len(t), 4), 20.0)
        amps[(t > stops_s) & (t < ends_s), 1] = 0.0
        monkeypatch.setattr(methods, "_currents", lambda file: (t, amps))
        return methods.motor_current(asked(table))

    stops = current(20.0, 45.0)
    assert stops is not None and stops.label == "rotor_failure" and stops.rotors == {2}
    assert stops.onset_s == pytest.approx(20.0, abs=0.02)
    assert current(20.0, 20.5) == Answer(NORMAL)
    monkeypatch.setattr(methods, "_currents", lambda file: None)
    assert methods.motor_current(asked(table)) is None


def test_every_method_answers_a_sound_flight() -> None:
    question = asked(sound())
    said = {name: method(question) for name, method in METHODS.items()}
    ours = said["uavtwin why"]
    assert ours is not None and not ours.rotors and ours.others == 0  # commands of it are constant
    assert said["motor current, PX4"] is None
    first = said["outputs part by 150 µs"]
    assert first is not None and first.label == NORMAL


def _said(label: str, answer: Answer | None, rotors: frozenset[int] = frozenset()) -> Said:
    onset_s = 10.0 if label == "rotor_failure" else None
    return Said(replace(FLIGHT, label=label, rotors=rotors, onset_s=onset_s), answer, 0.5)


def test_figures_are_those_of_the_answers() -> None:
    one = frozenset([1])
    rows = [
        _said("rotor_failure", Answer("rotor_failure", one, 10.2, 0.9), one),
        _said("rotor_failure", Answer("rotor_failure", frozenset([2]), 10.4, 0.8), one),
        _said("propeller", Answer("payload_cg", or_else="propeller", probability=0.7)),
        _said(NORMAL, Answer(NORMAL, probability=0.8, others=2)),
        _said(NORMAL, Answer("wind", probability=0.95)),
        _said(NORMAL, Answer("")),
        _said(NORMAL, None),
    ]
    s = score(rows)
    assert (s.asked, s.answered, s.flights, s.right, s.rotors) == (6, 5, 7, 4, (1, 2))
    assert s.onset_s == pytest.approx(0.3)
    assert (s.false, s.others, s.hours, s.wrong_and_sure) == (1, 2, 1.5, 1)
    assert s.brier == pytest.approx(np.mean([0.01, 0.04, 0.09, 0.04, 0.95**2]))


def test_probabilities_that_hold_have_no_calibration_error() -> None:
    p = np.repeat([0.1, 0.5, 0.9], 10)
    hit = np.concatenate([np.arange(10) < 10 * q for q in (0.1, 0.5, 0.9)]).astype(float)
    assert calibration_error(p, hit) == pytest.approx(0.0, abs=1e-12)
    assert calibration_error(p, 1.0 - hit) == pytest.approx((0.8 + 0.0 + 0.8) / 3)


def test_the_generated_part_replaces_itself_alone(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    old = "### own\n\nold\n\n### another\n\nstays\n"
    page.write_text(f"before\n{BEGIN}\n{old}\n{END}\nafter\n", "utf-8")
    said = {"ours": [_said("rotor_failure", Answer("rotor_failure", frozenset([1]), 10.1, 0.9))]}
    text = tables(said, [Outcome("gyro_bias", "large", True, False, 0.1, False)])
    write_between(page, text)
    written = page.read_text("utf-8")
    assert written.startswith("before\n") and written.endswith("after\n") and "old" not in written
    assert written.count("stays") == 1 and written.count("### own") == 1
    assert "| `gyro_bias` | large | 1 | 1 | 0 | 0.10 | 0 |" in written
    with pytest.raises(ValueError, match="has no"):
        write_between(Path(__file__).parent / "test_run.py", text)


def test_flights_stand_in_a_file_whose_other_sets_stay(tmp_path: Path) -> None:
    file = tmp_path / "flights.csv"
    said = {"ours": [_said("rotor_failure", Answer("rotor_failure", frozenset([1]), 10.1, 0.9))]}
    (row,) = flight_rows(said)
    assert row["ours"] == "*rotor failure 1, 10.10 s (0.90)*"
    write_flights(file, [{**row, "set": "another"}, {**row, "ours": "old"}])
    write_flights(file, [row])
    written = file.read_text("utf-8")
    assert written.count("another,") == 1 and "old" not in written and row["ours"] in written
