"""Pages weigh what they may, however many flights they show, and say what they leave out."""

import json
from base64 import b64decode
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup
from page_rigs.circle import much_of, recorded
from page_rigs.figures import figures_of
from places import DATA, needs

import uavtwin as ut
from uavtwin.report.autopilot import spectrogram
from uavtwin.report.drawing import (
    COARSEST,
    FINEST,
    MOST_PARTS,
    PAGE_BYTES,
    Budget,
    degenerate,
    fitted,
    packed,
    unpacked,
)
from uavtwin.report.gap import gap_page
from uavtwin.report.overview import overview
from uavtwin.report.page import Plot

QUIVER = sorted((DATA / "quiver_pt1").glob("*.BIN"))


def page_of(seeds: Sequence[int]) -> str:
    shown = overview(recorded(100.0))
    text = gap_page([much_of(s) for s in seeds], [shown] * len(seeds))
    assert len(text.encode("utf-8")) <= PAGE_BYTES
    figures = figures_of(text)
    faults = [
        f"{name}: {fault}"
        for name, figure in figures.items()
        if not name.endswith(("space", "above", "side"))
        for fault in degenerate(Plot(name, "", 1, Markup(json.dumps(figure))))
    ]
    assert faults == []
    return text


def numbers(text: str) -> int:
    """Of all curves of a page."""
    plots = [f for f in figures_of(text).values() if "data" in f]
    return sum(len(unpacked(t["x"])) for f in plots for t in f["data"])


OVER = "over-"
"""Figures of flights over each other."""


def flights_of(page: str) -> set[str]:
    """Flights that have figures of their own."""
    return {n.partition("-")[0] for n in figures_of(page) if not n.startswith(OVER)}


@pytest.mark.slow
def test_five_flights_are_drawn_as_finely_as_a_page_allows() -> None:
    """One flight is drawn at its finest, each of five more coarsely; none is left out."""
    one = page_of([0])
    five = page_of(range(5))
    assert len(five) > 0.85 * PAGE_BYTES, "room that is not used"
    assert flights_of(five) == {f"flight{i}" for i in range(5)}
    own = [name for name in figures_of(five) if not name.startswith(OVER)]
    assert len(own) == 5 * len(figures_of(one))
    assert f"in each of {FINEST} spans" in one and f"in each of {FINEST} spans" not in five
    assert "of the 5 flights" not in five
    assert numbers(one) < numbers(five) < 5 * numbers(one)


@pytest.mark.slow
def test_of_many_flights_those_furthest_off_are_drawn_and_all_are_listed() -> None:
    text = page_of([*range(10, 0, -1), 0, 30])
    drawn = flights_of(text)
    assert 1 < len(drawn) <= MOST_PARTS
    worst = [11, *range(len(drawn) - 1)]  # by their place on the command line
    assert drawn == {f"flight{i}" for i in worst}
    assert f"Figures of {len(drawn)} of the 12 flights" in text
    listed = text.partition('<h2 id="flights">')[2].partition("</table>")[0]
    assert all(f"flight {s}<" in listed for s in (*range(11), 30))
    assert listed.count('href="#flight') == len(drawn)


@pytest.mark.long
@needs(len(QUIVER) == 5, "no quiver_pt1: set UAVTWIN_DATA")
def test_five_recorded_flights_of_one_aircraft(tmp_path: Path) -> None:
    flights = [ut.read_flight(log) for log in QUIVER]
    vehicle = ut.draft_vehicle(flights, 18.0, arm_m=0.6).vehicle
    path = ut.gap(flights, vehicle).report(tmp_path / "report.html")
    assert path.stat().st_size <= PAGE_BYTES
    assert flights_of(path.read_text("utf-8")) == {f"flight{i}" for i in range(5)}


def test_a_page_is_drawn_finer_until_it_is_full() -> None:
    """Bytes that grow with the logarithm of the columns, a part each 200 kB at the coarsest."""
    asked: list[Budget] = []

    def draw(budget: Budget, fixed: int = 500_000) -> str:
        asked.append(budget)
        finer = int(300_000 * np.log(budget.columns / COARSEST))
        return "x" * (fixed + budget.parts * (200_000 + finer))

    assert len(fitted(draw, 1)) == len(draw(Budget(FINEST, 1)))
    assert 0.98 * PAGE_BYTES < len(fitted(draw, 2)) <= PAGE_BYTES
    assert fitted(draw, 99) == draw(Budget(COARSEST, 5))
    assert max(b.parts for b in asked) == MOST_PARTS
    assert fitted(lambda _: "x" * 2_000_000) == "x" * 2_000_000


@pytest.mark.slow
@given(st.lists(st.one_of(st.floats(-1e9, 1e9), st.just(float("nan"))), max_size=50), st.booleans())
def test_packed_numbers_are_as_exact_as_a_screen(values: list[float], log: bool) -> None:
    """To a part in 65,000 of what they span, or to single precision."""
    given = np.array(values)
    back = unpacked(packed(given, "log" if log else "linear"))
    np.testing.assert_array_equal(np.isnan(back), np.isnan(given))
    known = given[np.isfinite(given)]
    if len(known):
        size = np.abs(known).max()
        allowed = 1e-7 * np.abs(known) if log else np.ptp(known) / 65_000 + 1e-7 * size
        assert np.all(np.abs(back[np.isfinite(given)] - known) <= allowed + 1e-38)


def test_one_far_off_value_does_not_make_the_others_coarse() -> None:
    given = np.append(np.sin(np.arange(500) / 9), 1e6)
    assert np.abs(unpacked(packed(given)) - given)[:-1].max() < 1e-6
    assert packed(given[:-1])["dtype"] == "u2"


def test_a_spectrogram_with_fewer_columns_keeps_the_strongest() -> None:
    shown = spectrogram(recorded(100.0))
    assert shown is not None and shown.power_db.shape[1] > 100
    content = shown.content(70)
    assert (content["columns"], content["end"]) == (70, shown.end_s)
    cells, all_cells = (
        np.frombuffer(b64decode(str(c["cells"])), np.uint8).reshape(shown.power_db.shape[0], -1)
        for c in (content, shown.content())
    )
    np.testing.assert_array_equal(cells.max(axis=1), all_cells.max(axis=1))
