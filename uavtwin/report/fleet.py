"""Page of `uavtwin fleet`: aircraft that differ, numbers that drift, bad logs."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from twin.formatting import pretty_unit

from ..fleets.dataset import NO_LOG
from ..fleets.fleet_statistics import Drift, Measure, Spread, measures
from ..fleets.result import CELLS, FleetResult, of_logs, table_of
from ..fleets.statistics import FALSE_SHARE
from .drawing import Panels
from .page import BLUE, GREY, ORANGE, Plot, plot, render

Array = NDArray[np.float64]
MOST_ROWS = 100
"""Largest number of rows of a table."""
MOST_DRIFTS = 8
"""Largest number of drifts that are drawn."""
MOST_NUMBERS = 12
"""Largest number of numbers that are drawn by aircraft."""
MOST_AIRCRAFT = 60
"""Largest number of aircraft in a panel; of more, those that differ and a selection of the
others."""
MOST_POINTS = 400
"""Largest number of drawn flights of an aircraft."""
STATUSES = {
    "fine": "logs that are fine",
    "findings": "damaged logs",
    "refused": "logs of no use for a verb",
    "unreadable": "unreadable logs",
    NO_LOG: "files that are no logs",
    "copy": "copies of another log",
    "failed": "logs whose process ended",
}
"""Text on the number of logs by status."""
OUT = "#c23b66"
_PX = 210
"""Height of a panel, px."""


def page_text(result: FleetResult) -> str:
    """The page of a result."""
    by_aircraft, over_time = _drawn(result)
    bad = result.bad_logs(MOST_ROWS)
    return render(
        "fleet.html.j2",
        claim=result.claim,
        vehicle=result.vehicle,
        facts=_facts(result),
        cannot=result.cannot,
        misfits=result.misfits[:MOST_ROWS],
        overviews=[
            table_of(result.rows, "aircraft", MOST_ROWS),
            table_of(of_logs(result.folder), "flight", MOST_ROWS),
        ],
        cells=CELLS,
        false_share=FALSE_SHARE,
        tests={"differences": len(result.differences), "drifts": len(result.drifts)},
        differing=result.differing[:MOST_ROWS],
        drifting=result.drifting[:MOST_ROWS],
        nearly=[d for d in result.drifts if not d.significant][:5],
        by_aircraft=by_aircraft,
        over_time=over_time,
        spreads=result.spreads[:MOST_ROWS],
        effects=_effect_plots(result.spreads[:MOST_NUMBERS]),
        bad=bad.fillna("").to_dict("records"),
        most=MOST_ROWS,
    )


def _facts(result: FleetResult) -> dict[str, str]:
    """Facts of the fleet."""
    return {
        "logs": str(result.logs),
        **{STATUSES[s]: str(n) for s, n in result.statuses.items()},
        "aircraft": str(len(result.aircraft)),
        "flights with a date": str(result.dated),
        "vehicle": result.vehicle or "each aircraft has its own",
    }


def _drawn(result: FleetResult) -> tuple[list[Plot], list[Plot]]:
    """Figures by aircraft, and over time; each number is read once."""

    first = {d.number: k for k, d in reversed(list(enumerate(result.differences)))}
    numbers = sorted(first, key=lambda n: first[n])[:MOST_NUMBERS]
    drifts = result.drifting[:MOST_DRIFTS]
    by_aircraft: dict[int, Plot] = {}
    over_time: dict[int, Plot] = {}
    for m in measures(result.folder):
        if m.name in numbers:
            out = {d.aircraft for d in result.differing if d.number == m.name}
            by_aircraft[numbers.index(m.name)] = _by_aircraft(m, out)
        for k, drift in enumerate(drifts):
            if drift.number == m.name:
                over_time[k] = _over_time(m, drift, k)
    return (
        [by_aircraft[k] for k in sorted(by_aircraft)],
        [over_time[k] for k in sorted(over_time)],
    )


def _by_aircraft(m: Measure, out: set[str]) -> Plot:
    """A number of every flight, by aircraft."""
    names = sorted({str(a) for a in m.table["aircraft"]})
    if len(names) > MOST_AIRCRAFT:
        every = -(-len(names) // MOST_AIRCRAFT)
        names = sorted({*names[::every], *list(out)[:MOST_AIRCRAFT]})
    ticks = {"tickmode": "array", "tickvals": [*range(len(names))], "ticktext": _short(names)}
    panels = Panels((_PX,))
    axis: dict[str, Any] = {**ticks, "range": [-0.6, len(names) - 0.4]}
    axes = panels.add(_axis(m.name, m.unit), axis)
    for significant in (False, True):
        own = [(i, n) for i, n in enumerate(names) if (n in out) is significant]
        if not own:
            continue
        parts = [_values(m.table, n) for _, n in own]
        x = np.concatenate(
            [np.full(len(y), float(i)) for (i, _), y in zip(own, parts, strict=True)]
        )
        colour = OUT if significant else BLUE
        marked = {"mode": "markers", "marker": {"color": colour, "size": 5, "opacity": 0.5}}
        name = "differs" if significant else "flights"
        panels.line(axes, x, np.concatenate(parts), name, {"color": colour}, **marked)
    return plot(f"by-{m.name}", f"{m.name} of every flight, by aircraft", panels.figure)


def _values(table: pd.DataFrame, aircraft: str) -> Array:
    """Values of an aircraft, up to a number."""
    own = table[table["aircraft"] == aircraft]["value"].to_numpy(dtype=np.float64)
    return np.asarray(own[:: max(1, -(-len(own) // MOST_POINTS))])


def _over_time(m: Measure, drift: Drift, k: int) -> Plot:
    """A number of an aircraft over the date, with its slope."""
    own = m.table[m.table["aircraft"] == drift.aircraft].dropna(subset=["date_year"])
    own = own.iloc[:: -(-len(own) // MOST_POINTS)]
    year, y = (own[c].to_numpy(dtype=np.float64) for c in ("date_year", "value"))
    begin = float(year.min())
    days = 365.25 * (year - begin)
    panels = Panels((_PX,))
    title = {"title": {"text": f"days since {begin:.2f}"}}
    axes = panels.add(_axis(m.name, m.unit), title)
    marked = {"mode": "markers", "marker": {"color": BLUE, "size": 5, "opacity": 0.6}}
    panels.line(axes, days, y, "flights", {"color": BLUE}, **marked)
    ends = np.array([days.min(), days.max()])
    middle = float(np.median(days)), float(np.median(y))
    for name, slope, line in (
        ("median slope", drift.trend.slope, {"color": ORANGE, "width": 2}),
        ("95 %", drift.trend.low, {"color": GREY, "width": 1, "dash": "dot"}),
        ("95 %", drift.trend.high, {"color": GREY, "width": 1, "dash": "dot"}),
    ):
        panels.line(axes, ends, middle[1] + slope * (ends - middle[0]) / 30.0, name, line)
    label = f"{m.name} of {drift.aircraft} against the date"
    return plot(f"drift-{k}", label, panels.figure)


def _effect_plots(spreads: Sequence[Spread]) -> list[Plot]:
    """Numbers of effects, an estimate per aircraft."""
    return list(_effects(spreads))


def _effects(spreads: Sequence[Spread]) -> Iterator[Plot]:
    for s in spreads:
        several = s.aircraft[:MOST_AIRCRAFT]
        if len(several) < 2:
            continue
        names = _short([a.aircraft for a in several])
        ticks = {"tickmode": "array", "tickvals": [*range(len(names))], "ticktext": names}
        panels = Panels((_PX,))
        axes = panels.add(
            _axis(f"{s.effect}.{s.number}", s.unit),
            {**ticks, "range": [-0.6, len(names) - 0.4]},
        )
        panels.area(axes, s.common.low, s.common.high)
        x = np.arange(len(several), dtype=np.float64)
        value = np.array([a.value for a in several])
        for i, a in enumerate(several):
            ends = np.array([a.value - 1.96 * a.sd, a.value + 1.96 * a.sd])
            line = {"color": BLUE, "width": 1.5}
            panels.line(axes, np.full(2, float(i)), ends, "95 %", line, showlegend=False)
        for name, y, colour in (
            ("by its own flights", value, BLUE),
            ("drawn to the type", s.common.own[: len(several)], ORANGE),
        ):
            marked = {"mode": "markers", "marker": {"color": colour, "size": 7}}
            panels.line(axes, x, np.asarray(y), name, {"color": colour}, **marked)
        label = f"{s.effect} {s.number} of each aircraft, the mean of the type grey"
        yield plot(f"effect-{s.effect}-{s.number}", label, panels.figure)


def _axis(name: str, unit: str) -> str:
    """Title of an axis."""
    return name if unit in ("", "1") else f"{name}, {pretty_unit(unit)}"


def _short(names: Sequence[str]) -> list[str]:
    """Names that fit below an axis: their ends, where those are distinct. Since they come from
    logs, mark-up of plotly.js is escaped."""
    ends = [n if len(n) <= 18 else f"\N{HORIZONTAL ELLIPSIS}{n[-17:]}" for n in names]
    heads = [n if len(n) <= 18 else f"{n[:17]}\N{HORIZONTAL ELLIPSIS}" for n in names]
    distinct = (some for some in (ends, heads) if len(set(some)) == len(some))
    return [escape(n) for n in next(distinct, names)]
