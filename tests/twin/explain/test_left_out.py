"""One flight among several that cannot be used costs a warning, whatever the reason."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from twin.explain import explanation
from twin.explain.explanation import Explanation, explain
from twin.explain.usable import flown, usable_part, with_readings
from twin.logs import Flight
from twin.residuals.aligned import align_flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("forward", 2.5, (2.0, 1.0, -2.0)),
    ("hover", 1.5, (2.0, 1.0, -2.0)),
)


@pytest.fixture(scope="module")
def good() -> Flight:
    return fly(COPTER, COPTER, 1, "good", LEGS)


def changed(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[Flight], Flight]:
    return lambda f: replace(f, name="bad", table=change(f.table.copy()))


def only(table: pd.DataFrame, seconds: float, stems: tuple[str, ...]) -> pd.DataFrame:
    columns = [c for c in table if c.startswith(stems)]
    table.loc[table["time"] > seconds, columns] = np.nan
    return table


BAD: dict[str, tuple[Callable[[Flight], Flight], str]] = {
    "no commands": (
        changed(lambda t: t.drop(columns=[c for c in t if c.startswith("cmd_")])),
        "cmd_1",
    ),
    "other aircraft": (changed(lambda t: t.assign(cmd_5=0.5, cmd_6=0.5)), "more motor commands"),
    "never flies": (changed(lambda t: t.assign(phase="ground")), "never airborne"),
    "too short": (changed(lambda t: t[t["time"] < 3.0]), "in the air"),
    "one row": (changed(lambda t: t[:1]), "too short"),
    "no pose, no IMU": (
        changed(lambda t: t.drop(columns=[c for c in t if c.startswith(("acc", "gyro", "q_"))])),
        "no reading is known for long enough",
    ),
    "IMU lost": (
        changed(lambda t: only(t, 1.0, ("acc_", "gyro_"))),
        "no reading is known for long enough",
    ),
    "IMU lost, pressure known": (
        changed(lambda t: only(t.assign(baro_pa=101325.0), 1.0, ("acc_", "gyro_"))),
        "as in other flights",
    ),
}


class StopError(Exception):
    """The search was reached."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "side"),
    [
        *((kind, "fit") for kind in BAD),
        *((kind, "holdout") for kind in ("no commands", "IMU lost")),
    ],
)
def test_the_run_goes_on_without_it(
    kind: str, side: str, good: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil, word = BAD[kind]
    bad, other = spoil(good), replace(good, name="other")
    searched: list[str] = []

    def search(flights: list[Flight], *_: object, **__: object) -> None:
        searched.extend(f.name for f in flights)
        raise StopError

    monkeypatch.setattr(explanation, "name_effects", search)
    said: list[Explanation] = []
    real = explanation.Explanation

    def kept(*args: object, **kwargs: object) -> Explanation:
        said.append(real(*args, **kwargs))  # type: ignore[arg-type]
        return said[-1]

    monkeypatch.setattr(explanation, "Explanation", kept)
    fit, held = ([good, bad], [other]) if side == "fit" else ([good], [other, bad])
    with pytest.raises(StopError):
        explain(fit, held, COPTER)
    assert searched == ["good"]
    (warning,) = (w for w in said[-1].warnings if w.startswith("left out"))
    assert "bad" in warning and word in warning, warning


@pytest.mark.slow
def test_alone_it_is_a_verdict(good: Flight) -> None:
    for spoil, word in BAD.values():
        if word == "as in other flights":
            continue  # then there are none
        found = explain([spoil(good)], [], COPTER)
        assert found.verdict == "unusable"
        assert any(word in reason for reason in found.reasons), found.reasons


@pytest.mark.slow
def test_a_known_mass_aboard_counts(good: Flight) -> None:
    """What flew carries two fifths of the weight that is said: a finding, and no reason."""
    aboard = flown(good, COPTER, {"good": 1.5 * COPTER.mass_kg})
    assert usable_part(good, aboard)[2] == []
    (note,) = [n for n in align_flight(good, aboard).notes if "of its weight" in n]
    assert " 40 %" in note or " 41 %" in note or " 39 %" in note


@pytest.mark.slow
def test_flights_of_pressure_alone_stay_together(good: Flight) -> None:
    drop = [c for c in good.table if c.startswith(("acc", "gyro", "q_"))]
    table = good.table.drop(columns=drop).assign(baro_pa=101325.0)
    flights = [replace(good, name=n, table=table) for n in ("one", "two")]
    kept, reasons = with_readings(flights, COPTER)
    assert [f.name for f in kept] == ["one", "two"]
    assert reasons == []
