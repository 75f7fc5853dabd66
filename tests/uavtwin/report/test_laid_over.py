"""Flights over each other: one time axis, counted from the same event, a colour each."""

import json
from dataclasses import replace

import numpy as np
import pytest
from page_rigs.circle import gap_of, recorded

from twin.logs.autopilot import Autopilot, Interval
from twin.residuals.gap import FlightGap
from uavtwin.report.drawing import Budget, degenerate, unpacked
from uavtwin.report.gap import LaidOver, laid_over
from uavtwin.report.overview import Overview, overview
from uavtwin.report.page import Plot


def later(gap: FlightGap, by_s: float, name: str) -> FlightGap:
    """The same flight in a record that began earlier."""
    channels = tuple(replace(c, t_s=c.t_s + by_s) for c in gap.channels)
    phases = tuple((n, a + by_s, b + by_s) for n, a, b in gap.phases)
    return replace(gap, flight=name, channels=channels, phases=phases)


def drawn(*gaps: FlightGap, shown: Overview | None = None) -> LaidOver:
    found = laid_over(gaps, [shown] * len(gaps), Budget(300))
    assert found is not None
    assert [fault for _, _, figure in found.figures for fault in degenerate(figure)] == []
    return found


def curves(figure: Plot, axes: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    content = json.loads(figure.json)["data"]
    return {
        t["name"]: (unpacked(t["x"]), unpacked(t["y"])) for t in content if t["yaxis"] == f"y{axes}"
    }


@pytest.fixture(scope="module")
def one() -> FlightGap:
    return gap_of(recorded())


def test_the_same_flight_begun_later_lies_on_itself(one: FlightGap) -> None:
    """Both take off at zero, whatever their records say; measured above, residual below."""
    found = drawn(one, later(one, 7.25, "again"))
    assert found.zero == "take-off"
    assert [(title, mode) for title, mode, _ in found.figures] == [
        ("Specific force (accelerometer)", "teacher-forced"),
        ("Position", "short horizon, 0.5 s"),
    ]
    position = found.figures[1][2]
    assert position.time == "laid-over" and "time from take-off" in position.label
    for axes, values in (("", one.channels[1].measured), ("2", one.channels[1].residual)):
        both = curves(position, axes)
        assert list(both) == ["circle", "again"]
        for t_s, y in both.values():
            np.testing.assert_allclose(t_s, one.channels[1].t_s, atol=1e-3)
            np.testing.assert_allclose(y, values, atol=1e-4)


def test_time_is_counted_from_what_all_of_them_hold(one: FlightGap) -> None:
    """A flight that is in the air from the start of its record has no take-off."""
    flying = replace(one, flight="flying", phases=(("hover", 0.0, 20.0),))
    assert drawn(one, flying).zero == "the start of the record"
    armed = replace(
        recorded(),
        autopilot=Autopilot(armed=(Interval("armed", 2.0, 9.0), Interval("", 11.0, 19.0))),
    )
    found = drawn(one, flying, shown=overview(armed))
    assert found.zero == "arming"
    t_s, _ = curves(found.figures[1][2], "")["flying"]
    assert t_s[0] == pytest.approx(one.channels[1].t_s[0] - 2.0, abs=1e-3)
    assert found.figures[-1][:2] == ("Battery", "as logged")


def test_a_take_off_is_the_end_of_the_first_time_on_the_ground(one: FlightGap) -> None:
    spans = (("hover", 0.0, 4.0), ("ground", 4.0, 6.0), ("takeoff", 6.0, 8.0), ("hover", 8.0, 20.0))
    found = drawn(one, replace(one, flight="twice", phases=spans))
    assert found.zero == "take-off"
    t_s, _ = curves(found.figures[1][2], "")["twice"]
    assert t_s[0] == pytest.approx(0.5 - 6.0, abs=1e-3)


def test_what_only_one_flight_has_is_not_drawn(one: FlightGap) -> None:
    bare = replace(one, flight="bare", channels=one.channels[:1])
    (title, _, figure) = drawn(one, bare).figures[0]
    assert title.startswith("Specific force")
    assert set(curves(figure, "")) == {"circle", "bare"} and curves(figure, "3") == {}
    other_unit = replace(bare, channels=(replace(one.channels[0], unit="g"),))
    assert laid_over([one, other_unit], [None, None], Budget(300)) is None
    assert laid_over([one, replace(one, channels=())], [None, None], Budget(300)) is None
