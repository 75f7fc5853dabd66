"""Bands of a driven twin: conformal over flights, and held by the FMU on flights of other days."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from checker_rig import problems
from cli_rig import run
from numpy.typing import NDArray

import uavtwin as ut
from twin.errors import TwinError
from twin.logs import Flight
from twin.physics.accuracy import SEEN
from uavtwin.accuracy import FEWEST, Windows, bands_of, bound, measured_accuracy
from uavtwin.demo.flights import fly
from uavtwin.exports.bands import (
    FILE,
    OBSERVED,
    PLAIN,
    AccuracyRecord,
    accuracy_part,
    digest,
    read_accuracy,
    record_of,
)
from uavtwin.exports.credibility import FILE as CARD
from uavtwin.exports.write import export_parts
from uavtwin.force.open_loop import HORIZONS_S, QUANTITIES, Replay

COPTER = ut.load_vehicle("copter_default")
Array = NDArray[np.float64]


def made(seed: int, size: float = 1.0, lively: float = 3.0, n: int = 400) -> Windows:
    """A flight whose twin is off by normal numbers that grow with time, more of them where the
    motion is lively; each flight has a size of its own."""
    rng = np.random.default_rng(seed)
    used = rng.uniform(0, 1, n)
    seen = np.repeat(used[:, None, None] * np.ones(len(SEEN)), len(HORIZONS_S), axis=1)
    scale = size * np.exp(0.1 * rng.normal()) * np.where(used > 0.5, lively, 1.0)
    off = {
        q: np.abs(rng.normal(size=(n, len(HORIZONS_S)))) * scale[:, None] * np.array(HORIZONS_S)
        for q, _ in QUANTITIES
    }
    return Windows(f"made_{seed}", seen[:, 0], seen, off)


def covered(flight: Windows, taught: list[Windows]) -> tuple[float, float]:
    """Share of the positions of a flight inside the bands that others teach: calm and lively."""
    bands, _ = bands_of(taught)
    used = (flight.seen / np.array(bands.limits)).max(axis=2)
    shares = []
    for r, inside in enumerate((used <= bands.calm, (used > bands.calm) & (used <= 1))):
        within = flight.off["position"] <= np.array(bands.bands["position"][r])
        shares.append(float(within[inside].mean()))
    return shares[0], shares[1]


def test_a_bound_counts_flights_alike_and_the_worst_twice() -> None:
    """A long flight counts no more than a short one: of the mixture of thirds, whose two upper ones
    are of the flight from 0 to 2, 95 % are below 1.85."""
    short, long = np.linspace(0, 2, 401), np.linspace(0, 1, 100001)
    for flights in ([short, long], [long, short]):
        assert bound(flights) == pytest.approx(1.85, abs=0.01)
    assert bound([long, short[: FEWEST - 1]]) is None


def test_a_bound_of_many_flights_holds_as_often_as_it_says() -> None:
    """Of flights whose sizes differ by half."""
    rng = np.random.default_rng(0)

    def flight() -> Array:
        return np.asarray(np.abs(rng.normal(size=100)) * np.exp(0.5 * rng.normal()))

    held = []
    for _ in range(400):
        band = bound([flight() for _ in range(30)])
        assert band is not None
        held.append((flight() <= band).mean())
    assert 0.94 < np.mean(held) < 0.97


def test_bands_cover_flights_that_taught_nothing() -> None:
    shares = [covered(made(k), [made(100 * k + i) for i in (1, 2, 3)]) for k in range(1, 21)]
    for regime in np.mean(shares, axis=0):
        assert 0.94 < regime < 0.98


def test_a_twin_that_is_worse_than_the_compared_one_is_told_by_its_coverage() -> None:
    worse = np.mean(
        [covered(made(k, size=2.0), [made(1000 + k), made(2000 + k)]) for k in range(9)]
    )
    assert worse < 0.8
    lively = np.mean(
        [covered(made(k, lively=9.0), [made(1000 + k), made(2000 + k)]) for k in range(9)], axis=0
    )
    assert lively[0] > 0.94
    assert lively[1] < 0.6


def test_too_few_flights_or_windows_have_no_bands() -> None:
    with pytest.raises(TwinError, match="1 flight held out could be compared, 2 are needed"):
        bands_of([made(1)])
    with pytest.raises(TwinError, match=f"in fewer than 2 flights .* {FEWEST} times"):
        bands_of([made(1), made(2, n=FEWEST - 1)])


def test_times_alone_at_which_twins_have_left_the_envelope_have_no_bands() -> None:
    flights = [made(k) for k in (1, 2, 3)]
    for flight in flights:
        flight.seen[:, 3:] = 5.0
    bands, missing = bands_of(flights)
    assert bands.horizons_s == HORIZONS_S[:3]
    assert "barometer" in missing


def test_bands_do_not_fall_with_the_time_alone() -> None:
    flights = [made(k) for k in (1, 2)]
    for flight in flights:
        flight.off["velocity"][:, 2] *= 0.01
    for row in bands_of(flights)[0].bands["velocity"]:
        assert row[2] == row[1] < row[3]


def test_a_regime_of_too_few_windows_has_the_band_of_both_and_says_so() -> None:
    flights = [made(k) for k in (1, 2)]
    _, quiet = bands_of(flights)
    assert not any("," in what for what in quiet)
    for flight in flights:
        flight.seen[FEWEST // 2 :, -1] *= 0.01  # few are lively after 2 s
    bands, missing = bands_of(flights)
    calm, lively = bands.bands["velocity"]
    assert lively[0] > calm[0]
    told = missing["velocity, lively"]
    assert told.startswith("at 2 s the band of both regimes stands in")
    assert "velocity, calm" not in missing
    record = record_of(bands, {"made_1": 400, "made_2": 400}, missing)
    known = AccuracyRecord(
        vehicle=COPTER.name,
        vehicle_sha256=digest(COPTER),
        drive="command",
        twins={PLAIN: record},
        missing={},
    )
    _, card = accuracy_part(known, COPTER, "command", False, [])
    assert f"velocity, lively: {told}" in card.because


def test_a_table_without_a_regime_is_refused_by_what_it_lacks(tmp_path: Path) -> None:
    bands, without = bands_of([made(1), made(2)])
    found = AccuracyRecord(
        vehicle=COPTER.name,
        vehicle_sha256=digest(COPTER),
        drive="command",
        twins={PLAIN: record_of(bands, {}, without)},
        missing={},
    ).json()
    del found["twins"][PLAIN]["bands"]["velocity"]["lively"]
    (tmp_path / FILE).write_text(json.dumps(found))
    with pytest.raises(TwinError, match=f"{FILE}: has no 'lively'. explain writes it"):
        read_accuracy(tmp_path, COPTER)


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    """Three days of an aircraft that is as its twin."""
    return [fly(COPTER, COPTER, seed=k, name=f"day_{k}") for k in range(3)]


@pytest.mark.slow
def test_the_fmu_holds_its_bands_on_another_flight(flights: list[Flight], tmp_path: Path) -> None:
    low, high = (
        replace(f, table=f.table.assign(baro_pa=pressure + 12.0 * f.table["pos_z"]))
        for f, pressure in zip(flights, (1.013e5, 1.021e5), strict=False)
    )
    found = measured_accuracy(COPTER, [low, high])
    assert set(found.twins) == {PLAIN, OBSERVED}
    assert max(found.twins[OBSERVED].bands["barometer"]["lively"]) < 80.0  # Pa; the days have 800
    (tmp_path / FILE).write_text(json.dumps(found.json()))
    COPTER.save(tmp_path / "vehicle.toml")
    known = read_accuracy(tmp_path, ut.load_vehicle(tmp_path / "vehicle.toml"))
    twin = ut.twin(COPTER, drive="command", accuracy=known)
    names = [f"accuracy.error_95.{q}" for q, _ in QUANTITIES]
    fmu = tmp_path / "twin.fmu"
    for fmi in (3, 2):
        ut.export(twin, fmu, fmi=fmi)
        assert problems(fmu) == []
        assert ut.verify(fmu).passed
    shown = Replay(flights[2], COPTER).through(fmu, watch=("accuracy.valid", *names))
    valid = shown.watched[..., 0] > 0.5
    assert valid.mean() > 0.5
    off = np.linalg.norm(shown.off, axis=-1)  # (w, h, 4)
    share = (off <= shown.watched[..., 1:])[valid].mean(axis=0)
    assert (share > 0.88).all()
    heavy = Replay(flights[2], COPTER).through(
        fmu, {"airframe.mass": 1.06 * COPTER.mass_kg}, ("accuracy.valid", *names)
    )
    off = np.linalg.norm(heavy.off, axis=-1)
    lost = (off <= heavy.watched[..., 1:])[heavy.watched[..., 0] > 0.5].mean(axis=0)
    assert lost[0] < 0.7  # position


@pytest.mark.slow
def test_a_flight_whose_motion_is_not_measured_is_not_compared(flights: list[Flight]) -> None:
    """What is not measured counts as level and at rest in its place elsewhere."""
    table = flights[0].table.drop(columns=["pos_x", "pos_y", "pos_z"])
    with pytest.raises(TwinError, match="day_0: no measured position: the twin"):
        Replay(replace(flights[0], table=table), COPTER)


@pytest.mark.slow
def test_what_was_not_compared_is_nowhere_valid_and_the_card_says_why(
    flights: list[Flight], tmp_path: Path
) -> None:
    found, card = measured_accuracy(COPTER, flights[:2]), ut.credibility(COPTER)
    same = ut.twin(COPTER, drive="command", accuracy=found)
    wanted = ["uncertainty_characterization=2"]
    export_parts([same], card=card, require=wanted)
    of_the_day = {"barometer.ground_pressure": 99_000.0}
    export_parts([same], starts=of_the_day, card=card, require=wanted)
    with pytest.raises(TwinError, match="start values are set"):
        export_parts([same], starts={"airframe.mass": 1.2}, card=card, require=wanted)
    export_parts([same], starts={"airframe.mass": 1.2}, card=card)(tmp_path, lambda _: None)
    force = ut.learned_force("copter_drag")
    for twin, why in (
        (
            ut.twin(COPTER, drive="command", accuracy=measured_accuracy(COPTER, flights[:1])),
            "2 are needed",
        ),
        (
            ut.twin(
                ut.load_vehicle(force.folder / "vehicle.toml"),
                drive="command",
                force=force,
                accuracy=found,
            ),
            "learned force",
        ),
        (
            ut.twin(COPTER, drive="command", accuracy=read_accuracy(tmp_path / "none", COPTER)),
            f"no {FILE}",
        ),
    ):
        assert twin.assembly.parts["accuracy"].output_names == ("valid",)
        assert twin.bands is not None and why in twin.bands.because


@pytest.mark.slow
@pytest.mark.parametrize("observer", [True, False])
def test_export_takes_the_table_of_explain_over(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, observer: bool
) -> None:
    folder, out = tmp_path / "explained", tmp_path / "out"
    folder.mkdir()
    vehicle = ut.load_vehicle(COPTER.save(folder / "vehicle.toml"))
    (folder / "explain.json").write_text(
        '{"verdict": "named", "effects": [], "settings": {"hash": "0", "changed": {}}, '
        '"gap": {}, "holdout": [], "closed_loop": null}'
    )
    (folder / "run.json").write_text('{"inputs": []}')
    bands, without = bands_of([made(1), made(2)])
    table = AccuracyRecord(
        vehicle=vehicle.name,
        vehicle_sha256=digest(vehicle),
        drive="command",
        twins={OBSERVED: record_of(bands, {"made_1": 400, "made_2": 400}, without)},
        missing={PLAIN: "it left the envelope"},
    )
    (folder / FILE).write_text(json.dumps(table.json()))
    words = ("corrected-twin", "--evidence", folder, "--drive", "commands", "--out", out)
    code, _, err = run(capsys, "export", *words, *["--observer"] * observer)
    assert code == 0, err
    said = "corrected_twin.fmu: accuracy.valid is always false: bands of outputs: it left"
    assert (said in err, err.count("accuracy.valid")) == (not observer, 0 if observer else 1)
    fmu = out / "corrected_twin.fmu"
    variables = {v.name: v for v in fmpy.read_model_description(str(fmu)).modelVariables}
    outputs = {
        n for n, v in variables.items() if n.startswith("accuracy.") and v.causality == "output"
    }
    quantities = {f"accuracy.error_95.{q}" for q, _ in QUANTITIES}
    wanted = (
        {"accuracy.valid", "accuracy.envelope", *quantities} if observer else {"accuracy.valid"}
    )
    assert outputs == wanted
    with zipfile.ZipFile(fmu) as archive:
        card = json.loads(archive.read(CARD))
    factor = card["factors"]["uncertainty_characterization"]
    assert (factor["level"], FILE in card["evidence"]) == (2 if observer else 0, True)
    validation = card["factors"]["validation"]
    assert (validation["level"], "observer acts" in validation["because"]) == (observer, observer)
    assert ("made_1, made_2" if observer else "it left the envelope") in factor["because"]
    if observer:
        start = variables["accuracy.band.position.calm_1"].start
        assert float(start) == pytest.approx(bands.bands["position"][0][0], rel=1e-5)
    (folder / FILE).write_text(json.dumps(table.json() | {"vehicle_sha256": "0" * 64}))
    code, _, err = run(capsys, "export", *words, "--force")
    assert code == 2
    assert "other numbers" in err
