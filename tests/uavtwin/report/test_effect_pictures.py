"""Pictures of effects without a mean, and what makes a picture degenerate."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmarks.planted import unsteady
from twin.explain.stochastic.spectral import StochasticEffect
from twin.logs import Flight
from twin.logs.autopilot import Autopilot, Interval, Mode
from twin.residuals.channels import ChannelData
from twin.vehicle_file import load_vehicle
from uavtwin.report.drawing import Budget, Panels, degenerate
from uavtwin.report.evidence import unsteady_evidence, unsteady_strip, varies
from uavtwin.report.page import plot


@pytest.mark.long
def test_an_effect_without_a_mean_has_a_picture() -> None:
    seen = unsteady("stuck_sensor")
    plots, how = unsteady_evidence(
        seen.found, seen.flight, seen.residuals, seen.vehicle, Budget(200)
    )
    assert plots and seen.flight.name in how
    assert [fault for p in plots for fault in degenerate(p)] == []
    said = Autopilot((Mode("Hold", 0.0),), failsafes=(Interval("battery failsafe", 1.0, 2.0),))
    over = unsteady_strip("stuck_sensor", replace(seen.flight, autopilot=said))
    assert over is not None and over.group == plots[0].time, "page.js lays it over that figure"
    assert "battery failsafe" in over.json
    assert unsteady_strip("stuck_sensor", seen.flight) is None


def test_a_slow_force_over_time_has_a_strip_too() -> None:
    """Residuals of the gust are those of a held-out flight; its strip is of the same group."""
    t = np.arange(0, 20, 0.02)
    left = np.sin(t) + 0.1 * np.random.default_rng(0).standard_normal(len(t))
    piece = np.zeros(len(t), dtype=np.int64)
    channel = ChannelData("acc_x", "m/s^2", t, left, left, np.empty((len(t), 0)), piece)
    found = StochasticEffect("gust", 9.0, {}, {}, ("acc_x",), 0.9)
    said = Autopilot((Mode("Hold", 0.0),))
    flight = Flight("held_out", pd.DataFrame({"time": t}), autopilot=said)
    plots, _ = unsteady_evidence(found, flight, [channel], load_vehicle("feisi_x150"), Budget(200))
    over = unsteady_strip("gust", flight)
    assert [p.time for p in plots] == ["unsteady-gust", ""], "over time, and spectra"
    assert over is not None and over.group == "unsteady-gust"
    assert [fault for p in plots for fault in degenerate(p)] == []


def test_a_dot_an_empty_curve_and_panels_that_overlap_are_degenerate() -> None:
    panels = Panels((100, 100))
    first, second = panels.add("one"), panels.add("two")
    panels.line(first, np.zeros(9), np.ones(9), "constant over a constant", {})
    panels.line(second, np.arange(9.0), np.full(9, np.nan), "unknown", {})
    panels.layout["yaxis2"]["domain"] = [0.2, 0.9]
    found = list(degenerate(plot("x", "x", panels.figure)))
    assert found == ["constant over a constant: one dot", "unknown: 0 points", "panels overlap"]


def test_a_constant_is_no_scatter_and_what_noise_hides_neither() -> None:
    rng = np.random.default_rng(0)
    noise = 0.01 * rng.standard_normal(1000)
    swing = 0.2 * np.sin(np.arange(1000) / 50)
    assert not varies(0.2 + noise, noise)
    assert varies(swing + noise, noise)
    assert not varies(swing, 50 * noise)
