"""Compensator: sample by sample as in one go, causal, zero where it must be, refuses what it must.

The exported graph works in float32 on measured and virtual signals, `run` on residuals in float64:
they agree to some 1e-6 of each channel's size.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_rigs.residual_rig import UNITS, made_up, tiny

from learning.data.channels import CHANNELS
from learning.data.clustering import clusters_of
from learning.data.envelope import INSIDE, UNLIMITED
from learning.data.flights import ResidualFlight
from learning.data.scaling import fit_scaling, in_spans
from learning.export.streaming import INPUTS, streaming_model
from learning.export.write import streamed
from learning.model.compensator import Compensator, ModelInfo
from learning.model.family import Corrected
from learning.preset import Preset
from twin.errors import ModelError

PROTOCOLS = [("reconstruct", 0), ("track", 1), ("track", 7), ("free", 0)]
FLIGHT = made_up(0, every=3)


def untrained(protocol: str, horizon: int, preset: Preset, seed: int = 0) -> Compensator:
    """A compensator whose every weight and buffer is something, as after training."""
    torch.manual_seed(seed)
    chosen = [in_spans(FLIGHT)]
    clusters = clusters_of(preset, [FLIGHT], chosen, seed)
    commands = FLIGHT.commands.shape[1]
    info = ModelInfo(preset, protocol, horizon, FLIGHT.rate_hz, commands, clusters)  # type: ignore[arg-type]
    model = Compensator(info)
    model.set_scaling(fit_scaling([FLIGHT], chosen, preset.normalise))
    model.base.normal_(std=0.1)
    model.gate.uniform_()
    model.leftover.uniform_()
    model.spread_factor.uniform_()
    model.anomaly_scale.uniform_(0.5, 2.0)
    for parameter in model.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    return model


def as_streamed(model: Compensator, flight: ResidualFlight) -> Corrected:
    """By the exported graph, one sample after the other, NaN where nothing was measured."""
    n, graph = len(flight.t_s), streaming_model(model)
    correction, spread = np.zeros((n, 15)), np.tile(model.rms.numpy(), (n, 1))
    anomaly, inside = np.zeros(n), np.zeros(n, dtype=np.bool_)
    measured = np.where(flight.fresh, flight.virtual + flight.residual, np.nan)
    for span in flight.spans:
        rows = slice(*span)
        parts = (flight.virtual, flight.commands, flight.phase[:, None], measured, flight.fresh)
        given = {k: v[rows].astype(np.float32) for k, v in zip(INPUTS[:-1], parts, strict=True)}
        found = streamed(graph, given)
        correction[rows], spread[rows] = found["correction"], found["spread"]
        anomaly[rows], inside[rows] = found["anomaly"][:, 0], found["inside"][:, 0] > 0.5
    return Corrected(correction, spread, anomaly, inside)


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "horizon"), PROTOCOLS)
@pytest.mark.parametrize(
    "changes",
    [{}, {"skip": False, "spread_head": False, "normalise": "range", "features": False}],
)
def test_streaming_is_sequence(protocol: str, horizon: int, changes: dict[str, object]) -> None:
    model = untrained(protocol, horizon, tiny(**changes))
    model.place_reach.mul_(0.4)  # some samples are outside, and some far
    one, other = as_streamed(model, FLIGHT), model.run(FLIGHT)
    np.testing.assert_array_equal(one.inside, other.inside)
    assert protocol == "reconstruct" or 0.05 < other.inside[in_spans(FLIGHT)].mean() < 0.95
    np.testing.assert_allclose(one.correction / UNITS, other.correction / UNITS, atol=5e-6)
    np.testing.assert_allclose(one.spread / UNITS, other.spread / UNITS, atol=5e-6)
    assert np.isnan(other.anomaly).all() == (protocol != "track")
    anomaly = np.nan_to_num(other.anomaly)  # 0 where there is no alarm
    np.testing.assert_allclose(one.anomaly, anomaly, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "horizon"), PROTOCOLS)
@given(row=st.integers(10, 90), channel=st.integers(0, 14))
@settings(max_examples=8)
def test_nothing_newer_than_the_horizon_is_used(
    protocol: str, horizon: int, row: int, channel: int
) -> None:
    """A jump of the measurement shows a horizon later, never before; in `free` never at all."""
    model = untrained(protocol, horizon, tiny())
    residual = FLIGHT.residual.copy()
    residual[row, channel] += 10 * UNITS[channel]
    fresh = FLIGHT.fresh.copy()
    fresh[row, channel] = True
    before = replace(FLIGHT, fresh=fresh)
    change = model.run(replace(before, residual=residual)).correction - model.run(before).correction
    a, b = FLIGHT.spans[0]
    seen = np.flatnonzero(np.any(change[a:b] != 0, axis=1))
    if protocol == "free" or row + horizon >= b:
        assert not len(seen)
    else:
        assert seen[0] == row + horizon


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "horizon"), PROTOCOLS)
@given(cut=st.integers(2, 99))
@settings(max_examples=5)
def test_a_flight_cut_short_is_the_same_up_to_there(protocol: str, horizon: int, cut: int) -> None:
    model = untrained(protocol, horizon, tiny())
    arrays = ("t_s", "virtual", "residual", "fresh", "commands", "phase")
    parts = {name: getattr(FLIGHT, name)[:cut] for name in arrays}
    short = replace(FLIGHT, spans=((0, cut),), **parts)
    whole = model.run(FLIGHT).correction[:cut] / UNITS
    np.testing.assert_allclose(model.run(short).correction / UNITS, whole, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "horizon"), PROTOCOLS)
def test_zero_correction_far_outside_the_envelope(protocol: str, horizon: int) -> None:
    """Each feature by itself; `reconstruct` only repeats what it is given and knows no envelope.

    Neither heading (magnetometer) nor height take part.
    """
    model = untrained(protocol, horizon, tiny())
    for number in range(len(model.features)):
        virtual, commands = FLIGHT.virtual.copy(), FLIGHT.commands.copy()
        values = virtual if number < 13 else commands
        column = (
            [c for c in range(15) if CHANNELS[c] not in ("pos_x", "pos_y")][number]
            if number < 13
            else number - 13
        )
        values[20, column] += 100 * np.ptp(values[:, column])
        values[21, column] = np.nan
        found = model.run(replace(FLIGHT, virtual=virtual, commands=commands))
        outside = [20, 21]
        of_place = model.features[number].startswith(("gyro", "vel", "cmd"))
        if protocol == "reconstruct" or not of_place:
            assert found.inside[:50].all()
        else:
            assert not found.inside[outside].any() and found.inside[:20].all()
            assert not found.correction[outside].any()
            np.testing.assert_allclose(found.spread[20], model.rms.numpy())


def test_envelope_of_the_training_data_holds_them() -> None:
    model = untrained("free", 0, tiny())
    found = model.run(FLIGHT)
    flown = in_spans(FLIGHT)
    assert found.inside[flown].mean() >= INSIDE - 1 / flown.sum()
    assert not found.inside[~flown].any() and not found.correction[~flown].any()


@pytest.mark.parametrize("column", [0, 6])
def test_a_feature_never_seen_limits_nothing(column: int) -> None:
    unseen = np.arange(15) == column
    blind = replace(FLIGHT, virtual=FLIGHT.virtual * np.where(unseen, np.nan, 1.0))
    scaling = fit_scaling([blind], [in_spans(blind)], "centred")
    assert scaling.feature_scale[column] == UNLIMITED
    model = untrained("free", 0, tiny())
    model.set_scaling(scaling)
    seeing, blinded = model.run(FLIGHT), model.run(blind)
    assert seeing.inside.any()
    np.testing.assert_array_equal(seeing.inside, blinded.inside)
    others = ~unseen  # its own channel is predicted by what it reads
    np.testing.assert_allclose(
        seeing.correction[:, others], blinded.correction[:, others], rtol=1e-6
    )


@torch.no_grad()
def test_state_zero_is_the_mean() -> None:
    """Before the first measurement the residual is taken to be the phase's mean."""
    model = untrained("reconstruct", 0, tiny())
    graph, nothing = streaming_model(model), np.zeros((1, 15), np.float32)
    for phase in (1, 2, 4):
        unknown = {
            "virtual": nothing,
            "command": np.zeros((1, 2), np.float32),
            "phase": np.full((1, 1), phase, np.float32),
            "measured": nothing,
            "valid": nothing,
        }
        mean = model.mean[phase].numpy()[None]
        at_mean = unknown | {"measured": mean, "valid": np.ones_like(nothing)}
        one, other = (streamed(graph, given)["correction"] for given in (unknown, at_mean))
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rate_hz": 50.0}, "50 Hz.*100 Hz"),
        ({"commands": np.zeros((300, 4))}, "4 motor commands.*with 2"),
    ],
)
def test_other_flights_are_refused(change: dict[str, object], said: str) -> None:
    model = untrained("free", 0, tiny())
    with pytest.raises(ModelError, match=said):
        model.run(replace(FLIGHT, **change))  # type: ignore[arg-type]


@pytest.mark.parametrize(("protocol", "horizon"), [("track", 0), ("free", 3), ("reconstruct", 1)])
def test_horizon_goes_with_the_protocol(protocol: str, horizon: int) -> None:
    with pytest.raises(ModelError, match=f"{protocol}: horizon {horizon}"):
        untrained(protocol, horizon, tiny())
