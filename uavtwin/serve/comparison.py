"""Page with two flights overlaid, and the facts in their logs side by side."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.formatting import number
from twin.frames import to_euler
from twin.logs import AnyFlight
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL

from ..report.drawing import Budget, Panels, fitted
from ..report.page import BLACK, ORANGE, Plot, plot, render

HERE = Path(__file__).parent
"""Folder of the templates."""
_PANEL_PX = 96
"""Height of a panel, px."""
_LINES = ({"color": BLACK, "width": 1.4}, {"color": ORANGE, "width": 1.4})
"""Line styles of the first flight and of the second."""
_GROUND = ("", "ground")
"""Phases in which an aircraft does not fly."""
Array = NDArray[np.float64]
Curve = tuple[Array, Array]
"""Times, s, and values."""
_FIGURES: tuple[tuple[str, tuple[tuple[str, tuple[str, ...]], ...]], ...] = (
    ("Height and velocity", (("up, m", POS[2:]), *((f"{c}, m/s", (c,)) for c in VEL))),
    ("Attitude", tuple((f"{n}, deg", QUAT) for n in ("roll", "pitch", "yaw"))),
    ("Body rates", tuple((f"{c}, rad/s", (c,)) for c in GYRO)),
    ("Specific force", tuple((f"{c}, m/s²", (c,)) for c in ACC)),
    ("Motors and battery", (("mean command, 1", ("cmd",)), ("battery, V", ("vbat_v",)))),
)
"""Title of each figure, and title and columns of each of its panels."""


def comparison_page(first: AnyFlight, second: AnyFlight, name: str, other_name: str) -> str:
    """The page of two flights; time counts from take-off where both logs have it.

    Args:
        first: First flight.
        second: Second flight.
        name: Name of the first flight.
        other_name: Name of the second flight.
    """
    flights, names = (first, second), (name, other_name)
    begins = [take_off_s(f) for f in flights]
    shifts = [0.0, 0.0] if None in begins else [b or 0.0 for b in begins]
    ends = [f.time_s[[0, -1]] - shift for f, shift in zip(flights, shifts, strict=True)]
    span = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))

    def page(budget: Budget) -> str:
        """The page with the resolution that the budget allows."""
        figures = []
        for title, panels in _FIGURES:
            rows = [(t, _curves(flights, shifts, t, columns)) for t, columns in panels]
            rows = [(t, curves) for t, curves in rows if any(curves)]
            if rows:
                figures.append(_figure(title, rows, names, span, budget))
        return render(
            "compare.html.j2",
            folder=HERE / "templates",
            names=names,
            begins=None if None in begins else begins,
            figures=figures,
            facts=list(side_by_side(first.facts, second.facts)),
            parameters=list(side_by_side(*map(_parameters, flights))),
        )

    return fitted(page)


def take_off_s(flight: AnyFlight) -> float | None:
    """Time of take-off, s from the start of its log; None: not known."""
    codes, names = flight.phase_codes
    flying = ~np.isin(codes, [k for k, n in enumerate(names) if n in _GROUND])
    return float(flight.time_s[int(np.argmax(flying))]) if flying.any() else None


def side_by_side(first: Mapping[str, str], second: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    """Name, first and second value of each fact, different ones first; "" where one lacks it."""
    names = list(dict.fromkeys((*first, *second)))
    differ = [n for n in names if first.get(n) != second.get(n)]
    for name in (*differ, *(n for n in names if n not in differ)):
        yield name, first.get(name, ""), second.get(name, "")


def _parameters(flight: AnyFlight) -> dict[str, str]:
    """Parameters of the autopilot that differ from their defaults."""
    if flight.autopilot is None:
        return {}
    return {p.name: number(p.value) for p in flight.autopilot.parameters}


def _figure(
    title: str,
    rows: Sequence[tuple[str, Sequence[Curve | None]]],
    names: Sequence[str],
    span: tuple[float, float],
    budget: Budget,
) -> Plot:
    """A figure with a panel per row, both flights in each."""
    panels = Panels((_PANEL_PX,) * len(rows), "compare")
    for k, (panel, curves) in enumerate(rows):
        axes = panels.add(panel)
        for curve, name, line in zip(curves, names, _LINES, strict=True):
            if curve is not None:
                panels.series(axes, *curve, name, line, budget.columns, band=False)
                panels.figure["data"][-1] |= {"legendgroup": name, "showlegend": k == 0}
    panels.look(*span, ())
    return plot(f"compare-{title}", f"{title} of both flights over time", panels.figure)


def _curves(
    flights: Sequence[AnyFlight], shifts: Sequence[float], panel: str, columns: tuple[str, ...]
) -> list[Curve | None]:
    """Curve of each flight in a panel."""
    found = [_curve(f, panel, columns) for f in flights]
    return [c and (c[0] - shift, c[1]) for c, shift in zip(found, shifts, strict=True)]


def _curve(flight: AnyFlight, panel: str, columns: tuple[str, ...]) -> Curve | None:
    """Times and values; None where the flight has none."""
    if columns == ("cmd",):
        columns = tuple(c for c in flight.columns if c.startswith("cmd_") and flight.has(c))
    if not columns or not flight.has(*columns):
        return None
    t_s, values = flight.signal(columns)
    if columns == QUAT:
        angle = ("roll", "pitch", "yaw").index(panel.partition(",")[0])
        return t_s, np.degrees(np.asarray(to_euler(values.T))[angle])
    mean = values.mean(axis=1)
    return t_s, -mean if columns == POS[2:] else mean
