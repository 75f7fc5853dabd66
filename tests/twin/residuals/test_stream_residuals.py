"""Residuals of a flight that goes on are those of the whole flight afterwards."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from places import DATA, needs
from sample_logs import flown_table

from twin.logs import Flight, read_flight
from twin.logs.columns import ACC, GYRO, POS, QUAT
from twin.logs.flight import Settled
from twin.residuals.flight_gap import flight_gap
from twin.residuals.gap import Channel
from twin.residuals.stream import Stream
from twin.residuals.stream_residuals import ResidualBlock, StreamResiduals
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle

AGREES = 1e-9
ByChannel = dict[tuple[str, float], list[Channel]]


def residuals_in_flight(
    table: pd.DataFrame, vehicle: Vehicle, every_s: float
) -> tuple[Stream, ByChannel, list[ResidualBlock]]:
    """All residuals of rows that come in pieces of some length."""
    stream, found, blocks = Stream(vehicle), ByChannel(), []
    residuals = StreamResiduals(stream)
    time = table["time"].to_numpy()
    edges = np.searchsorted(time, np.arange(time[0], time[-1] + every_s, every_s)).tolist()
    for first, end in zip(edges, [*edges[1:], len(table)], strict=True):
        if end > first:
            stream.push({str(c): table[c].to_numpy()[first:end] for c in table})
            blocks.append(residuals.update())
    blocks.append(residuals.update(final=True))
    kept = [b for b in blocks if b is not None]
    for block in kept:
        for channel in (*block.channels, *block.short):
            found.setdefault((channel.name, channel.horizon_s), []).append(channel)
    return stream, found, kept


def check_same(table: pd.DataFrame, vehicle: Vehicle, every_s: float) -> list[ResidualBlock]:
    stream, found, blocks = residuals_in_flight(table, vehicle, every_s)
    gap = flight_gap(Flight("flown", table, settled=stream.settled), vehicle)
    assert {(c.name, c.horizon_s) for c in gap.channels} == set(found)
    for channel in gap.channels:
        parts = found[channel.name, channel.horizon_s]
        np.testing.assert_allclose(
            np.concatenate([p.t_s for p in parts]), channel.t_s, rtol=0, atol=1e-12
        )
        for name in ("measured", "simulated", "residual"):
            live = np.concatenate([getattr(p, name) for p in parts])
            np.testing.assert_allclose(live, getattr(channel, name), rtol=0, atol=AGREES)
        assert np.concatenate([p.phase for p in parts]).tolist() == channel.phase.tolist()
    return blocks


@pytest.fixture(scope="module")
def copter() -> Vehicle:
    return load_vehicle("copter_default")


@pytest.mark.slow
@pytest.mark.parametrize("every_s", [0.3, 1.0, 7.0])
def test_the_same_numbers_whenever_it_is_asked(copter: Vehicle, every_s: float) -> None:
    blocks = check_same(flown_table().iloc[:1500], copter, every_s)
    assert max(len(b.channels) for b in blocks) == 6


@pytest.mark.slow
def test_one_push_of_everything(copter: Vehicle) -> None:
    """A batch is a stream of one portion."""
    check_same(flown_table().iloc[:5000], copter, 1000.0)


@pytest.mark.slow
def test_the_same_numbers_across_gaps(copter: Vehicle) -> None:
    """The IMU pauses, the position ends for a while, the ground is said for two seconds."""
    table = flown_table().iloc[:2500].copy()
    t = table["time"].to_numpy()
    table.loc[(t > 6.0) & (t < 7.2), [*ACC, *GYRO]] = np.nan
    table.loc[(t > 8.3) & (t < 9.1), [*POS, *QUAT]] = np.nan
    table.loc[(t > 12.0) & (t < 14.0), "phase"] = "ground"
    table.loc[np.arange(len(table)) % 3 != 0, list(POS)] = np.nan
    check_same(table, copter, 1.0)


@pytest.mark.slow
def test_the_same_numbers_from_the_ground_up(copter: Vehicle) -> None:
    """Where it rests is settled at lift-off, and noted."""
    table = flown_table().iloc[:1800].copy()
    t = table["time"].to_numpy()
    table.loc[t < 5.0, [f"cmd_{i}" for i in range(1, 5)]] = 0.0
    table.loc[t < 6.0, "pos_z"] = -0.02
    table.loc[t > 16.0, [f"cmd_{i}" for i in range(1, 5)]] = 0.0
    table.loc[t > 15.0, "pos_z"] = 1.5  # lands elsewhere
    stream, _, _ = residuals_in_flight(table, copter, 1.0)
    assert stream.settled is not None and stream.settled.resting_down_m == pytest.approx(-0.02)
    check_same(table, copter, 1.0)


@pytest.mark.slow
def test_blocks_follow_each_other(copter: Vehicle) -> None:
    """Each row of the grid once, in order, with the flight around it."""
    _, _, blocks = residuals_in_flight(flown_table().iloc[:1500], copter, 1.0)
    rows = np.concatenate([b.aligned.inputs.t_s for b in blocks if b.aligned is not None])
    np.testing.assert_allclose(np.diff(rows), 0.005, atol=1e-9)
    for before, block in pairwise(blocks):
        assert block.start_s == before.end_s <= block.end_s
        assert block.flight.time_s[0] <= max(block.start_s - 2.0, block.flight.time_s[0])
        assert len(block.flight.table) < 700


def test_a_twin_without_commands_waits_and_says_for_what(copter: Vehicle) -> None:
    table = flown_table().iloc[:600].drop(columns=[f"cmd_{i}" for i in range(1, 5)])
    stream, found, _ = residuals_in_flight(table, copter, 1.0)
    assert not found and "cmd_1" in stream.waits_for and stream.settled is None


def test_a_signal_that_comes_later_is_told(copter: Vehicle) -> None:
    table = flown_table().iloc[:600]
    stream = Stream(copter)
    stream.push({str(c): table[c].to_numpy() for c in table})
    assert stream.lacks(["vbat_v"]) == []
    assert stream.advance()
    assert stream.lacks(["vbat_v", "baro_pa", "q_w"]) == ["vbat_v"]


@pytest.mark.slow
@needs((DATA / "rflysimdt").is_dir(), "no recorded flights")
def test_a_recorded_flight() -> None:
    flight = read_flight(DATA / "rflysimdt" / "real_3.ulg")
    table = flight.between(0.0, 20.0).table
    check_same(table, load_vehicle("feisi_x150"), 1.0)


@pytest.mark.slow
def test_the_rate_of_a_filter_is_settled(copter: Vehicle) -> None:
    """What would be a median of the whole flight is what the recording notes."""
    flight = Flight("flown", flown_table().iloc[:600])
    rate_z = [
        flight_gap(replace(flight, settled=s), copter).channels[-1].residual
        for s in (None, *(Settled({"acc_x": r, "gyro_x": r}) for r in (100.0, 70.0)))
    ]
    np.testing.assert_allclose(rate_z[1], rate_z[0], atol=1e-9)
    assert not np.allclose(rate_z[2], rate_z[0], atol=1e-6)
