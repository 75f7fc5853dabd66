"""Flights laid over each other: the same quantity of several over one time axis, a colour each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.residuals.gap import Channel, FlightGap

from .drawing import Budget, Panels
from .figures import RESIDUAL_PX, SIGNAL_PX, pretty_unit
from .kinds import KINDS, Kind, grouped, mode
from .overview import Overview
from .page import BLUE, Figure, Plot, plot

Array = NDArray[np.float64]
Line = tuple[int, Array, Array]
"""Place of a flight among those laid over each other, times, s, and values, shape (n,)."""
GROUP = "laid-over"
COLOURS = (BLUE, "#d9622b", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66")


@dataclass(frozen=True, slots=True)
class LaidOver:
    """What the template needs of flights laid over each other.

    Attributes:
        zero: What time is counted from, in words.
        figures: Title, how the twin was held against the flights, and the figure, per quantity.
    """

    zero: str
    figures: tuple[tuple[str, str, Plot], ...]


def laid_over(
    gaps: Sequence[FlightGap], overviews: Sequence[Overview | None], budget: Budget
) -> LaidOver | None:
    """Measured and residual of every channel that two flights share; None where there is none.

    Args:
        gaps: Flights; the first six are drawn.
        overviews: What each was; None: not kept.
        budget: Of the page.
    """
    gaps, overviews = gaps[: len(COLOURS)], overviews[: len(COLOURS)]
    zero, begins = _begins(gaps, overviews)
    figures = []
    for kind, horizon_s, channels in _shared(gaps):
        panels = Panels((SIGNAL_PX, RESIDUAL_PX) * len(channels), GROUP)
        for name, of_flights in channels.items():
            unit = pretty_unit(next(iter(of_flights.values())).unit)
            for what, attribute in ((name, "measured"), ("residual", "residual")):
                lines = [
                    (i, c.t_s - begins[i], getattr(c, attribute)) for i, c in of_flights.items()
                ]
                _add(panels, f"{what}, {unit}", lines, gaps, budget)
        title = f"{kind.title}, {mode(horizon_s)}"
        name = f"over-{kind.prefix.rstrip('_') or 'other'}-{round(horizon_s * 1000)}ms"
        label = f"{title}, of {len(gaps)} flights: measured and residual over the time from {zero}"
        figures.append((kind.title, mode(horizon_s), plot(name, label, _looked(panels, zero))))
    battery = _battery(gaps, overviews, begins, budget)
    if battery is not None:
        label = f"Battery of {len(gaps)} flights over the time from {zero}"
        figure = plot("over-battery", label, _looked(battery, zero))
        figures.append(("Battery", "as logged", figure))
    return LaidOver(zero, tuple(figures)) if figures else None


def _begins(
    gaps: Sequence[FlightGap], overviews: Sequence[Overview | None]
) -> tuple[str, list[float]]:
    """What time is counted from, the same in all flights, and when that was in each, s."""
    lifted = [_lift_off_s(gap) for gap in gaps]
    if all(at is not None for at in lifted):
        return "take-off", [at for at in lifted if at is not None]
    armed = [
        min((s.start_s for s in o.told.autopilot.armed), default=None)
        if o is not None and o.told.autopilot is not None
        else None
        for o in overviews
    ]
    if armed and all(at is not None for at in armed):
        return "arming", [at for at in armed if at is not None]
    return "the start of the record", [0.0] * len(gaps)


def _lift_off_s(gap: FlightGap) -> float | None:
    """End of the first time on the ground; None where the record does not hold it."""
    for (name, _, end_s), after in zip(gap.phases, gap.phases[1:], strict=False):
        if name == "ground" and after[0] != "ground":
            return end_s
    first = gap.phases[0] if gap.phases else ("", 0.0, 0.0)
    return first[1] if first[0] == "takeoff" else None


def _shared(
    gaps: Sequence[FlightGap],
) -> list[tuple[Kind, float, dict[str, dict[int, Channel]]]]:
    """Quantities in the order of a page: kind, horizon, and by name the channel of each flight;
    only what two flights have in one unit."""
    found: dict[tuple[int, float], dict[str, dict[int, Channel]]] = {}
    for i, gap in enumerate(gaps):
        for kind, members in grouped(gap.channels):
            place = KINDS.index(kind), members[0].horizon_s
            by_name = found.setdefault(place, {})
            for c in members:
                of_flights = by_name.setdefault(c.name, {})
                if len(c.t_s) > 1 and all(c.unit == o.unit for o in of_flights.values()):
                    of_flights.setdefault(i, c)
    shared = []
    for (k, horizon_s), by_name in sorted(found.items(), key=lambda item: item[0]):
        several = {name: each for name, each in by_name.items() if len(each) > 1}
        if several:
            shared.append((KINDS[k], horizon_s, several))
    return shared


def _battery(
    gaps: Sequence[FlightGap],
    overviews: Sequence[Overview | None],
    begins: Sequence[float],
    budget: Budget,
) -> Panels | None:
    """Voltage and current of those flights that log them."""
    found: dict[str, list[Line]] = {}
    for i, shown in enumerate(overviews):
        for words, t_s, values in shown.battery if shown is not None else ():
            found.setdefault(words, []).append((i, t_s - begins[i], values))
    several: Mapping[str, list[Line]] = {w: lines for w, lines in found.items() if len(lines) > 1}
    if not several:
        return None
    panels = Panels((SIGNAL_PX,) * len(several), GROUP)
    for words, lines in several.items():
        _add(panels, words, lines, gaps, budget)
    return panels


def _add(
    panels: Panels, title: str, lines: Sequence[Line], gaps: Sequence[FlightGap], budget: Budget
) -> None:
    """A panel with a curve of each flight; the figure looks at all of them."""
    axes = panels.add(title)
    ends = [v for _, t_s, _ in lines for v in (float(t_s[0]), float(t_s[-1]))]
    before = panels.layout["xaxis"].get("range", ends)
    panels.look(min(*ends, *before), max(*ends, *before), ())
    for i, t_s, values in lines:
        line = {"color": COLOURS[i], "width": 1.5}
        name = gaps[i].flight
        panels.series(axes, t_s, values, name, line, budget.columns, band=False)


def _looked(panels: Panels, zero: str) -> Figure:
    """The figure over the time from `zero`; its keys go together with those of the others."""
    panels.layout["meta"]["keys"] = GROUP
    last = max((k for k in panels.layout if k.startswith("xaxis")), key=lambda k: int(k[5:] or 1))
    panels.layout[last]["title"] = {"text": f"time from {zero}, s"}
    return panels.figure
