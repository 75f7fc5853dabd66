"""Pictures of effects without a mean, and what makes a picture degenerate."""

import numpy as np
import pytest

from benchmarks.planted import unsteady
from uavtwin.report.drawing.budget import Budget
from uavtwin.report.drawing.degenerate import degenerate
from uavtwin.report.drawing.panels import Panels
from uavtwin.report.evidence.plots import unsteady_evidence
from uavtwin.report.evidence.steady import varies
from uavtwin.report.page import plot


@pytest.mark.slow
def test_an_effect_without_a_mean_has_a_picture() -> None:
    seen = unsteady("stuck_sensor")
    plots, how = unsteady_evidence(
        seen.found, seen.flight, seen.residuals, seen.vehicle, Budget(200)
    )
    assert plots and seen.flight.name in how
    assert [fault for p in plots for fault in degenerate(p)] == []


def test_a_dot_an_empty_curve_and_panels_that_overlap_are_degenerate() -> None:
    panels = Panels((100, 100))
    first, second = panels.add("one"), panels.add("two")
    panels.line(first, np.zeros(9), np.ones(9), "constant over a constant", {})
    panels.line(second, np.arange(9.0), np.full(9, np.nan), "unknown", {})
    panels.layout["yaxis2"]["domain"] = [0.2, 0.9]
    found = list(degenerate(plot("x", "x", panels.figure)))
    assert found == ["constant over a constant: one dot", "unknown: 0 points", "panels overlap"]


def test_a_constant_is_no_scatter() -> None:
    rng = np.random.default_rng(0)
    noise = 0.01 * rng.standard_normal(1000)
    assert not varies(0.2 + noise)
    assert varies(0.2 * np.sin(np.arange(1000) / 50) + noise)
