"""Training: repeatable to the byte, resumable, never worse than without the network."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_rigs.residual_rig import UNITS, made_up, tiny, train
from scipy.signal import lfilter

from learning.data.channels import CHANNELS
from learning.data.flights import ResidualFlight
from learning.data.scaling import fit_scaling, in_spans
from learning.data.sequences import LAGS, OF_THE_DAY, error_of_today, sequences
from learning.model.compensator import Compensator
from learning.model.family import TrainingTask
from learning.model.folder import CURVE, MODEL, WEIGHTS, load
from learning.model.linear import fit_base, gates, predict_base, regressors
from learning.model.registry import preset_named
from learning.preset import Preset, Protocol
from learning.training import train as training
from learning.training.checkpoint import CHECKPOINT
from learning.training.train import fit_model
from learning.training.windows import validation_rows
from twin.errors import ModelError

FLIGHTS = [made_up(0), made_up(1)]
AWAY = made_up(2)
FILES = (WEIGHTS, MODEL, CURVE)


class KilledError(Exception):
    pass


def kill_after(epochs: int, preset: Preset) -> Callable[[float, float | None], None]:
    def progress(done: float, left: float | None) -> None:
        if done >= epochs / preset.epochs - 1e-9:
            raise KilledError

    return progress


def left(model: Compensator, flight: ResidualFlight) -> np.ndarray:
    """Mean square of what is left, over the spread of the channel, shape (15,)."""
    error = np.where(flight.fresh, flight.residual - model.run(flight).correction, np.nan)
    inside = in_spans(flight)
    found = np.nanmean(error[inside] ** 2, axis=0) / np.nanvar(flight.residual[inside], axis=0)
    return np.asarray(found)


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "horizon"), [("reconstruct", 0), ("track", 2), ("free", 0)])
def test_killed_and_resumed_is_uninterrupted(
    protocol: Protocol, horizon: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    preset = tiny()
    monkeypatch.setattr(training, "CHECKPOINT_S", 0.0)
    train(FLIGHTS, preset, protocol, horizon, 3, tmp_path / "whole")
    for epochs in (1, 3):
        with pytest.raises(KilledError):
            train(
                FLIGHTS,
                preset,
                protocol,
                horizon,
                3,
                tmp_path / "cut",
                kill_after(epochs, preset),
            )
        assert (tmp_path / "cut" / CHECKPOINT).is_file()
    train(FLIGHTS, preset, protocol, horizon, 3, tmp_path / "cut")
    for name in FILES:
        whole, cut = (tmp_path / folder / name for folder in ("whole", "cut"))
        assert whole.read_bytes() == cut.read_bytes(), name
    assert not (tmp_path / "cut" / CHECKPOINT).exists()


@pytest.mark.slow
def test_same_seed_same_bytes_other_seed_others(tmp_path: Path) -> None:
    """Whatever was drawn before, and however many threads there are; neither is touched."""
    threads = torch.get_num_threads()
    torch.manual_seed(11)
    train(FLIGHTS, tiny(), "track", 1, 0, tmp_path / "a")
    torch.set_num_threads(2)
    torch.manual_seed(12)
    before = torch.random.get_rng_state()
    train(FLIGHTS, tiny(), "track", 1, 0, tmp_path / "b")
    assert torch.equal(before, torch.random.get_rng_state()) and torch.get_num_threads() == 2
    torch.set_num_threads(threads)
    train(FLIGHTS, tiny(), "track", 1, 1, tmp_path / "c")
    a, b, c = (tmp_path / folder for folder in "abc")
    assert all((a / name).read_bytes() == (b / name).read_bytes() for name in FILES)
    assert (a / WEIGHTS).read_bytes() != (c / WEIGHTS).read_bytes()


@pytest.mark.slow
def test_training_again_takes_the_finished_model(tmp_path: Path) -> None:
    seen: list[float] = []

    def progress(done: float, left_s: float | None) -> None:
        seen.append(done)

    train(FLIGHTS, tiny(), "free", 0, 0, tmp_path, progress)
    assert seen == [0.25, 0.5, 0.75, 1.0, 1.0]
    train(FLIGHTS, tiny(), "free", 0, 0, tmp_path, progress)
    assert len(seen) == 6


@pytest.mark.slow
def test_a_foreign_checkpoint_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    preset = tiny()
    monkeypatch.setattr(training, "CHECKPOINT_S", 0.0)
    with pytest.raises(KilledError):
        train(FLIGHTS, preset, "free", 0, 0, tmp_path, kill_after(1, preset))
    with pytest.raises(ModelError, match=r"another training.*delete it"):
        train(FLIGHTS, preset, "free", 0, 1, tmp_path)
    (tmp_path / CHECKPOINT).write_bytes(b"\x08\0\0\0\0\0\0\0garbage!")
    with pytest.raises(ModelError, match="not readable"):
        train(FLIGHTS, preset, "free", 0, 0, tmp_path)
    (tmp_path / CHECKPOINT).unlink()
    train(FLIGHTS, preset, "free", 0, 1, tmp_path)
    assert load(tmp_path).info.seed == 1


@pytest.mark.slow
def test_reconstruction_learns(tmp_path: Path) -> None:
    """Twenty epochs on two short flights bring a held-out one below a tenth in variance."""
    preset = tiny(epochs=20, clustering="sensors", n_codes=64, code_size=8)
    model = train(FLIGHTS, preset, "reconstruct", 0, 0, tmp_path)
    assert left(model, AWAY).mean() < 0.1
    curve = json.loads((tmp_path / CURVE).read_text())
    assert len(curve) == 20
    assert curve[-1]["reconstruction"] < 0.7 * curve[0]["reconstruction"]


@pytest.mark.slow
def test_free_finds_what_the_features_tell(tmp_path: Path) -> None:
    """The made-up residual follows the speed of the next channel, besides a drift of its own."""
    flights = [made_up(seed, n=900, gain=1.5) for seed in range(3)]
    model = train(flights, tiny(), "free", 0, 0, tmp_path / "free")
    away = made_up(9, n=900, gain=1.5)
    inside = model.run(away).inside.mean()
    assert inside > 0.8
    told = left(model, away)
    assert np.median(told) < 0.6, told
    silent = train([made_up(s, gain=0.0) for s in range(2)], tiny(), "free", 0, 0, tmp_path / "0")
    away = made_up(9, gain=0.0)
    nothing = np.mean(away.residual**2, axis=0) / np.var(away.residual, axis=0)  # with its offset
    assert np.median(left(silent, away) / nothing) < 1.15


def test_free_corrects_no_offset_of_the_day(tmp_path: Path) -> None:
    """Two flights have one in common; of sensors that says nothing of the third, of motion it does.
    What moves is corrected all the same."""
    flights = [made_up(seed, n=900, gain=1.5) for seed in range(2)]
    lifted = [replace(f, residual=f.residual + 5 * UNITS) for f in flights]
    model = fit_model(lifted, *preset_named("linear"), TrainingTask("free"), tmp_path)
    away = made_up(9, n=900, gain=1.5)
    found = model.run(away)
    mean = found.correction[found.inside].mean(axis=0) / UNITS
    assert np.all(np.abs(mean[OF_THE_DAY]) < 0.7) and np.all(mean[9:] > 3)
    rows = away.fresh & found.inside[:, None]
    about = np.where(rows, away.residual, np.nan)
    left = np.nanstd(about - found.correction, axis=0) / np.nanstd(about, axis=0)
    assert np.median(left[OF_THE_DAY]) < 0.7


def test_a_channel_without_measurements_stays_uncorrected(tmp_path: Path) -> None:
    blind = made_up(5)
    blind.fresh[:, 6:9] = False
    blind.residual[:, 6:9] = np.nan
    model = train([blind], tiny(epochs=2), "reconstruct", 0, 0, tmp_path)
    found = model.run(AWAY)
    assert not found.correction[:, 6:9].any() and found.correction[:, 0:6].any()


@pytest.mark.slow
def test_stops_early_and_keeps_the_best(tmp_path: Path) -> None:
    """A rate far too high makes it worse at once; patience ends it."""
    preset = tiny(epochs=60, validate_every=1, patience=3, learning_rate=0.3, schedule="constant")
    model = train(FLIGHTS, preset, "track", 5, 0, tmp_path)
    curve = json.loads((tmp_path / CURVE).read_text())
    best = model.info.metrics["best_epoch"]
    assert len(curve) == best + 3 < 60
    assert curve[best - 1]["validation"] == min(e["validation"] for e in curve)


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "horizon"), [("track", 1), ("track", 30), ("free", 0)])
def test_gate_never_makes_the_validation_error_larger(
    protocol: Protocol, horizon: int, tmp_path: Path
) -> None:
    model = train(FLIGHTS, tiny(), protocol, horizon, 0, tmp_path)
    errors = model.info.metrics["validation_mse"]
    for name in CHANNELS:
        assert errors[name]["with_network"] <= errors[name]["linear"] * (1 + 1e-9), name


@given(seed=st.integers(0, 1000), scale=st.floats(-3, 3))
@settings(max_examples=30)
def test_gates_are_least_squares_within_bounds(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    target = rng.normal(size=(50, 15))
    y = scale * target + rng.normal(size=(50, 15))
    scored = rng.random((50, 15)) < 0.7
    gate = gates(y, target, scored, np.arange(50))
    assert np.all((gate >= 0) & (gate <= 1))

    def error(share: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum((target - share * y) ** 2, axis=0, where=scored))

    for other in np.linspace(0, 1, 11):
        assert np.all((error(gate) <= error(np.full(15, other)) + 1e-9) | (gate == 0))
    assert np.all(error(gate) <= error(np.zeros(15)))


def test_a_gain_that_could_be_chance_opens_no_gate() -> None:
    """Slow noise against slow noise: one long wave each, whatever they have in common."""
    rng = np.random.default_rng(0)
    slow = lfilter([1.0], [1.0, -0.98], rng.normal(size=(1600, 30)), axis=0)
    y, target = slow[:, :15], slow[:, 15:]
    scored, blocks = np.ones((1600, 15), dtype=np.bool_), np.arange(1600) // 100
    assert np.mean(gates(y, target, scored, np.arange(1600)) > 0) > 0.3  # taken as independent
    assert np.mean(gates(y, target, scored, blocks) > 0) < 0.15
    assert np.mean(gates(y, y + target, scored, blocks) > 0) > 0.9


@pytest.mark.slow
def test_linear_prediction_is_the_autoregression_that_made_the_data() -> None:
    """x[t+1] = 0.9 x[t] + noise: three samples ahead the best weight is 0.9^3 on the newest."""
    flight = made_up(0, n=6000, gain=0.0)
    rng = np.random.default_rng(1)
    noise = rng.normal(size=flight.residual.shape)
    for row in range(1, len(noise)):
        flight.residual[row] = 0.9 * flight.residual[row - 1] + noise[row]
    chosen = [in_spans(flight)]
    scaling = fit_scaling([flight], chosen, "pooled")
    spans = sequences([flight], scaling, "track", 3)
    weights = fit_base(spans, [s.fresh for s in spans], "track", flight.rate_hz)
    expected = np.zeros(weights.shape[1])
    expected[[0, LAGS]] = 0.9**3, 1.0  # about the running mean, and that
    size = np.mean([np.std(regressors(spans[0], "track", c), axis=0) for c in range(15)], axis=0)
    np.testing.assert_allclose(weights.mean(0) * size, expected * size, atol=0.03)
    share = np.var(spans[1].d - predict_base(spans[1], weights, "track", scaling.largest), axis=0)
    np.testing.assert_allclose(share.mean(), 1 - 0.9**6, atol=0.03)


@pytest.mark.slow
def test_a_steady_sensor_under_a_twin_that_jitters_reads_what_it_read() -> None:
    """Residual = slow reading - virtual: the linear prediction must not hold the twin's noise."""
    flight = made_up(0, n=1500)
    rng = np.random.default_rng(2)
    virtual = rng.normal(size=flight.virtual.shape)
    reading = lfilter([1.0], [1.0, -0.999], 0.01 * rng.normal(size=virtual.shape), axis=0)
    jittery = replace(flight, virtual=virtual, residual=reading - virtual)
    scaling = fit_scaling([jittery], [in_spans(jittery)], "pooled")
    spans = sequences([jittery], scaling, "track", 10)
    weights = fit_base(spans, [s.fresh for s in spans], "track", jittery.rate_hz)
    left = np.concatenate([s.d - predict_base(s, weights, "track", scaling.largest) for s in spans])
    assert np.median(np.mean(left**2, axis=0)) < 0.02


@pytest.mark.slow
def test_a_twin_of_no_use_is_not_looked_at() -> None:
    """Residual = noise - virtual: the sensor reads its mean, whatever the twin says."""
    flights = []
    for seed in range(3):
        flight, rng = made_up(seed, n=600), np.random.default_rng(seed)
        virtual = rng.normal(size=flight.virtual.shape)
        reading = 5.0 + 0.1 * rng.normal(size=virtual.shape)
        flights.append(replace(flight, virtual=virtual, residual=reading - virtual))
    scaling = fit_scaling(flights[:2], [in_spans(f) for f in flights[:2]], "pooled")
    tasks: list[tuple[Protocol, int]] = [("track", 10), ("free", 0)]
    for protocol, horizon in tasks:
        spans = sequences(flights, scaling, protocol, horizon)
        taught = [s for s in spans if s.flight < 2]
        weights = fit_base(taught, [s.fresh for s in taught], protocol, flights[0].rate_hz)
        (new,) = {s.flight for s in spans} - {s.flight for s in taught}
        left = [
            s.d - predict_base(s, weights, protocol, scaling.largest)
            for s in spans
            if s.flight == new
        ]
        error = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)) * scaling.scale[0]
        of_day = OF_THE_DAY & (protocol == "free")
        assert error[~of_day].max() < 0.13, protocol
        assert np.all(error[of_day] < 0.25), "the mean of a short flight is off"


@pytest.mark.slow
def test_a_twin_that_leaves_is_not_corrected_by_all_the_way_it_has_gone(tmp_path: Path) -> None:
    """Taught that the sensor reads 5, whatever the twin says, by flights that stay in place."""
    flights = []
    for seed in range(2):
        flight, rng = made_up(seed, n=600), np.random.default_rng(seed)
        virtual = rng.normal(size=flight.virtual.shape)
        flights.append(replace(flight, virtual=virtual, residual=5.0 - virtual))
    gone = flights[0].virtual.copy()
    gone[:, [i for i, c in enumerate(CHANNELS) if c.startswith("pos")]] += 1000.0
    leaving = replace(flights[0], virtual=gone)
    tasks: list[tuple[Protocol, int]] = [("track", 10), ("free", 0)]
    for protocol, horizon in tasks:
        model = train(flights, tiny(), protocol, horizon, 0, tmp_path / protocol)
        at_home, away = (np.abs(model.run(f).correction).max() for f in (flights[0], leaving))
        assert at_home > 3 and away < 3 * at_home, protocol


def test_held_back_for_validation() -> None:
    few = validation_rows(FLIGHTS, 0.2, seed=0)
    for flight, rows in zip(FLIGHTS, few, strict=True):
        for phase in (1, 2):
            assert 0.15 < rows[in_spans(flight) & (flight.phase == phase)].mean() < 0.25
    whole = validation_rows(FLIGHTS, 0.2, seed=0, least=2)
    assert sum(v.all(where=in_spans(f)) for f, v in zip(FLIGHTS, whole, strict=True)) == 1
    flights = [made_up(s) for s in range(6)]
    lonely = int(np.flatnonzero([v.any() for v in validation_rows(flights, 0.2, seed=0)])[0])
    whole = validation_rows(flights, 0.2, seed=0)
    for number, (flight, held) in enumerate(zip(flights, whole, strict=True)):
        assert np.array_equal(held, in_spans(flight) & (number == lonely))
    flights[lonely].phase[150:] = 4  # a phase that no other flight has: not to be lost to training
    apart = validation_rows(flights, 0.2, seed=0)
    of_its_own = in_spans(flights[lonely]) & (flights[lonely].phase == 4)
    assert 0.15 < apart[lonely][of_its_own].mean() < 0.25
    assert not apart[lonely][:150].any()
    assert sum(v.all(where=in_spans(f)) for f, v in zip(flights, apart, strict=True)) == 1


def test_flights_of_two_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="100 Hz with 2 motor commands, 100 Hz with 4"):
        train([made_up(0), made_up(1, commands=4)], tiny(), "free", 0, 0, tmp_path)
    empty = made_up(0)
    empty.fresh[:] = False
    with pytest.raises(ModelError, match="made_up_0: no span with a measured residual"):
        train([empty], tiny(), "free", 0, 0, tmp_path)
    with pytest.raises(ModelError, match="at least one flight"):
        train([], tiny(), "free", 0, 0, tmp_path)


def test_a_loss_that_is_not_finite_is_said(tmp_path: Path) -> None:
    preset = tiny(learning_rate=1e30, schedule="constant", clip=None, skip=True)
    with pytest.raises(ModelError, match=r"not finite in epoch \d.*learning_rate"):
        train(FLIGHTS, preset, "reconstruct", 0, 0, tmp_path)


@pytest.mark.slow
def test_spread_is_calibrated(tmp_path: Path) -> None:
    """On a flight like the training's about two thirds of the samples are within one spread."""
    flights = [made_up(seed, n=900) for seed in range(3)]
    model = train(flights, tiny(), "track", 2, 0, tmp_path)
    away = made_up(9, n=900)
    found = model.run(away)
    rows = in_spans(away) & found.inside
    within = np.abs(away.residual - found.correction)[rows] < found.spread[rows]
    assert 0.55 < within.mean() < 0.8


@pytest.mark.slow
def test_an_alarm_rings_for_a_fault_and_hardly_without(tmp_path: Path) -> None:
    """On a flight like the training's; the fault, a step of ten spreads, from its first sample on
    until its sensor is followed again."""
    flights = [made_up(seed, n=900) for seed in range(3)]
    model = train(flights, tiny(), "track", 2, 0, tmp_path)
    away, at = made_up(9, n=900), 600
    clean, rows = model.run(away), in_spans(away)
    assert np.mean(clean.anomaly[rows] > 1) < 0.01
    assert np.mean(clean.anomaly[rows]) > 0.1  # not for being silent
    residual = away.residual.copy()
    residual[at:, 0] += 10 * clean.spread[at, 0]
    broken = model.run(replace(away, residual=residual))
    np.testing.assert_array_equal(broken.anomaly[:at], clean.anomaly[:at])
    assert np.all(broken.anomaly[at : at + 2] > 1)


@pytest.mark.slow
def test_a_channel_that_training_never_had_rings_no_alarm(tmp_path: Path) -> None:
    blind = made_up(5)
    blind.fresh[:, 6:9] = False
    model = train([blind], tiny(epochs=2), "track", 2, 0, tmp_path)
    seen, unseen = (made_up(2) for _ in range(2))
    unseen.fresh[:, 6:9] = False
    one, other = (model.run(flight).anomaly for flight in (seen, unseen))
    np.testing.assert_allclose(one, other, rtol=1e-3)


@pytest.mark.slow
def test_flights_that_know_nothing_of_each_other_still_tell_an_alarm(tmp_path: Path) -> None:
    """One on the spot, one that is fast: neither is inside the envelope of the other."""
    slow, fast = made_up(0), made_up(1)
    fast.virtual[:, 12:14] += 30.0
    model = train([slow, fast], tiny(), "track", 2, 0, tmp_path)
    assert (model.spread_factor > 0).all()
    residual = slow.residual.copy()
    residual[200:, 0] += 1000.0
    assert model.run(replace(slow, residual=residual)).anomaly[200] > 1


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_a_residual_that_never_changed_rings_when_it_does_and_not_before(
    offset: float, tmp_path: Path
) -> None:
    steady, away = made_up(5), made_up(2)
    for flight in (steady, away):
        flight.residual[:, 9] = offset
    model = train([steady], tiny(epochs=2), "track", 2, 0, tmp_path)
    clean = model.run(away).anomaly
    fresh = away.fresh.copy()
    fresh[:, 9] = False
    unseen = model.run(replace(away, fresh=fresh)).anomaly
    np.testing.assert_allclose(clean, unseen, rtol=0.05, atol=0.05)
    broken = away.residual.copy()
    broken[200:, 9] += 50.0
    assert model.run(replace(away, residual=broken)).anomaly[200] > 1


def test_wrong_presets_are_refused() -> None:
    with pytest.raises(ModelError, match="1 or more"):
        tiny(n_codes=0)
    with pytest.raises(ModelError, match="temperature 0"):
        tiny(temperature=0.0)


@pytest.mark.slow
def test_an_offset_of_another_size_than_all_that_were_learned_from_is_followed() -> None:
    """Two flights agree about an offset, the third has another: a running mean tells it in time."""
    flights = []
    for seed, offset in ((0, 5.0), (1, 5.0), (2, -20.0)):
        flight, rng = made_up(seed, n=3000, gain=0.0), np.random.default_rng(seed)
        residual = offset + rng.normal(size=flight.residual.shape)
        flights.append(replace(flight, residual=residual))
    scaling = fit_scaling(flights[:2], [in_spans(f) for f in flights[:2]], "pooled")
    spans = sequences(flights, scaling, "track", 10)
    taught, new = ([s for s in spans if (s.flight < 2) == seen] for seen in (True, False))
    weights = fit_base(taught, [s.fresh for s in taught], "track", flights[0].rate_hz)
    for span in new:
        late = slice(len(span.d) // 2, None)
        left = (
            (span.d - predict_base(span, weights, "track", scaling.largest)) * scaling.scale[0]
        )[late]
        assert np.all(np.abs(left.mean(axis=0)) < 25 / 3)
        assert np.all(left.std(axis=0) < 1.3)


def test_an_error_counts_from_when_it_is_known() -> None:
    """Three times as far off as expected, all along; a sensor that reads nothing is as expected."""
    size, fresh = np.full((1000, 2), 3.0), np.tile([True, False], (1000, 1))
    today = error_of_today(size, fresh, 10, 100.0)
    assert (today[:10] == 1).all() and (today[:, 1] == 1).all()
    assert (np.diff(today[9:, 0]) > 0).all()
    assert today[-1, 0] == pytest.approx(3 * math.sqrt(math.pi / 2), rel=0.02)
