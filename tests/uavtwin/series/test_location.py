"""Positions on the Earth in MCAP: there and back, measured and twin, and a recorded flight where
its satellites had it."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from places import DATA, needs
from pymavlink import mavutil
from series_rigs.mcap_rig import Read, read_mcap

from twin.logs import Flight, read_flight, write_flight
from twin.logs.airframe import Airframe, Place, SourcedValue
from twin.residuals.gap import Channel, FlightGap
from twin.vehicle.earth import geodetic_of_ned
from uavtwin.gaps import GapResult
from uavtwin.series.files import write_series
from uavtwin.series.mcap import write_flight_mcap

ORIGIN = Place(math.radians(48.1), math.radians(-11.5), 512.0, None)
QUIVER = DATA / "quiver_pt1" / "pt1_00000092.BIN"
N = 50
T = np.arange(N, dtype=np.float64) * 0.1
WAY: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = np.column_stack(
    [30 * np.sin(T), 20 * np.cos(T), -T]
)


def places(messages: list[tuple[int, dict[str, Any]]]) -> np.ndarray:
    """Latitude, longitude, rad, and height, m."""
    told = [[m[k] for k in ("latitude", "longitude", "altitude")] for _, m in messages]
    return np.array(told) * [np.pi / 180, np.pi / 180, 1.0]


def flown(airframe: Airframe | None) -> Flight:
    table = {"time": T, **dict(zip(("pos_x", "pos_y", "pos_z"), WAY.T, strict=True))}
    table["pos_y"] = np.where(np.arange(N) % 2, np.nan, table["pos_y"])
    return Flight("made_up", pd.DataFrame(table), airframe=airframe)


def written(flight: Flight, tmp_path: Path) -> Read:
    write_flight_mcap(flight, tmp_path / "flight.mcap")
    return read_mcap(tmp_path / "flight.mcap")


def test_a_flight_is_where_its_origin_says(tmp_path: Path) -> None:
    """At every whole sample of the position; a flight table in Parquet keeps the origin."""
    flight = flown(Airframe(origin=SourcedValue(ORIGIN, "made up")))
    write_flight(flight, tmp_path / "flight.parquet")
    for each in (flight, read_flight(tmp_path / "flight.parquet")):
        read = written(each, tmp_path)
        fixes = read.messages["/location"]
        assert [t for t, _ in fixes] == (np.arange(0, N, 2) * 100_000_000).tolist()
        assert read.schemas["/location"]["title"] == "foxglove.LocationFix"
        first = fixes[0][1]
        assert (first["timestamp"], first["frame_id"]) == ({"sec": 0, "nsec": 0}, "ned")
        assert first["position_covariance_type"] == 0
        o = ORIGIN
        expected = geodetic_of_ned(WAY[::2], o.latitude_rad, o.longitude_rad, o.height_m)
        np.testing.assert_allclose(places(fixes), expected, rtol=1e-14, atol=1e-9)


def test_without_an_origin_there_is_no_location(tmp_path: Path) -> None:
    for airframe in (None, Airframe(place=SourcedValue(ORIGIN, "made up"))):
        assert "/location" not in written(flown(airframe), tmp_path).schemas


def test_measured_and_twin_are_both_on_the_map(tmp_path: Path) -> None:
    """The twin 1 m further north than the flight; residuals are nowhere."""
    phase = np.full(N, "", dtype=np.str_)
    off = WAY + np.array([1.0, 0.0, 0.0])
    each = zip("xyz", WAY.T, off.T, strict=True)
    channels = tuple(Channel(f"pos_{a}", "m", 0.5, T, m, s, phase) for a, m, s in each)
    gap = FlightGap("made_up", "none", channels, (), (), {}, origin=ORIGIN)
    (series,) = GapResult((gap,)).series()
    write_series(series, tmp_path / "gap.mcap")
    read = read_mcap(tmp_path / "gap.mcap")
    there = {t for t, s in read.schemas.items() if s["title"] == "foxglove.LocationFix"}
    assert there == {"/measured/location", "/twin/location"}
    measured, twin = (places(read.messages[t]) for t in sorted(there))
    assert len(measured) == len(twin) == N
    np.testing.assert_allclose((twin - measured)[:, 0] * 6_371e3, 1.0, atol=0.01)
    write_series(replace(series, origin=None), tmp_path / "gap.mcap")
    read = read_mcap(tmp_path / "gap.mcap")
    assert not any(topic.endswith("location") for topic in read.schemas)


@pytest.mark.slow
@needs(QUIVER.is_file(), "no quiver_pt1: set UAVTWIN_DATA")
def test_a_recorded_flight_is_where_the_autopilot_says(tmp_path: Path) -> None:
    """Latitude and longitude of POS in the log, which no reader of ours has touched: the autopilot
    takes the Earth for a sphere, which is 0.7 % at most; the flight stays within 30 m."""
    fixes = places(written(read_flight(QUIVER), tmp_path).messages["/location"])
    log, logged = mavutil.mavlink_connection(str(QUIVER)), []
    while (message := log.recv_match(type="POS")) is not None:
        logged.append((message.Lat, message.Lng, message.Alt))
    metre = np.array([6_371e3, 6_371e3 * np.cos(fixes[0, 0])])
    said = np.radians(np.array(logged)[:, :2]) * metre
    apart = np.linalg.norm((fixes[:, :2] * metre)[:, None] - said[None], axis=2).min(axis=1)
    assert len(fixes) > 300 and apart.max() < 0.5
    heights = np.array(logged)[:, 2]
    assert fixes[:, 2].min() > heights.min() - 1.0 and fixes[:, 2].max() < heights.max() + 1.0
