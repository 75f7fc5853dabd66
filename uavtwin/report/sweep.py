"""Page of `uavtwin sweep`: results of the runs, important factors, the worst runs."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from twin.formatting import pretty_unit

from ..sweeps.result import SweepResult
from .drawing import Panels
from .page import BLUE, GREY, ORANGE, Plot, plot, render

Array = NDArray[np.float64]
MOST_POINTS = 3000
"""Largest number of points in a panel; more would overlap."""
MOST_FACTORS = 12
"""Largest number of factors that are drawn."""
COLOURS = {"flown": BLUE, "run": BLUE, "lost": ORANGE, "failed": "#c23b66"}
_PX = 210
"""Height of a panel, px."""


def page_text(result: SweepResult) -> str:
    """The page of a result."""
    table, figure = result.table, result.led_by
    unit = pretty_unit(result.units.get(figure, ""))
    influences = result.influences(figure)
    shown = _thinned(table)
    plots = []
    if figure:
        plots.append(_distribution(table, figure, unit))
        names = [i.factor for i in influences[:MOST_FACTORS]]
        if names:
            plots.append(_against(shown, names, figure, unit))
    return render(
        "sweep.html.j2",
        name=result.name,
        claim=result.claim,
        method=result.design.method,
        outcomes=result.counts,
        figures=result.record.figures,
        units={n: pretty_unit(u) for n, u in result.units.items()},
        figure=figure,
        influences=influences,
        sobol=any(np.isfinite(i.total) for i in influences),
        plots=plots,
        note=f"{len(shown)} of {len(table)} runs are drawn; all are in runs.parquet."
        if len(shown) < len(table)
        else "",
        factors=list(result.design.vary),
        worst=[
            {"row": row, "again": result.again(int(row["run"]))}
            for row in result.worst().to_dict("records")
        ],
    )


def _thinned(table: pd.DataFrame) -> pd.DataFrame:
    """A selection of rows, with all that did not end well first."""
    if len(table) <= MOST_POINTS:
        return table
    bad = table[table["outcome"].isin(["lost", "failed"])].head(MOST_POINTS // 2)
    good = table.drop(bad.index)
    every = -(-len(good) // (MOST_POINTS - len(bad)))
    return pd.concat([good.iloc[::every], bad]).sort_index()


def _distribution(table: pd.DataFrame, figure: str, unit: str) -> Plot:
    """Cumulative distribution of a figure over the runs."""
    values = np.sort(table[figure].dropna().to_numpy(dtype=np.float64))
    share = np.arange(1, len(values) + 1) / len(values)
    keep = np.unique(np.linspace(0, len(values) - 1, min(len(values), 800)).astype(int))
    panels = Panels((_PX,))
    axes = panels.add("share of the runs", {"title": {"text": f"{figure}, {unit}"}})
    line = {"color": BLUE, "width": 1.8, "shape": "hv"}
    panels.line(axes, values[keep], share[keep], figure, line)
    return plot("distribution", f"Share of the runs whose {figure} is below a value", panels.figure)


def _against(table: pd.DataFrame, factors: list[str], figure: str, unit: str) -> Plot:
    """A figure over each factor, a point per run."""
    panels = Panels((_PX,) * len(factors))
    panels.layout["height"] += 44 * (len(factors) - 1)
    seen: set[str] = set()
    for i, factor in enumerate(factors):
        values, axis = _along(table[factor])
        axes = panels.add(f"{figure}, {unit}", {"title": {"text": factor}, **axis})
        _make_room(panels, i, len(factors))
        for outcome, rows in table.assign(_x=values).groupby("outcome", sort=True):
            colour = COLOURS.get(str(outcome), GREY)
            more: dict[str, Any] = {
                "mode": "markers",
                "marker": {"color": colour, "size": 5, "opacity": 0.6},
                "legendgroup": str(outcome),
                "showlegend": outcome not in seen,
                "text": [f"run {run}" for run in rows["run"]],
                "hovertemplate": "%{text}: %{y:.3g} at %{x}<extra></extra>",
            }
            seen.add(str(outcome))
            x, y = (rows[c].to_numpy(dtype=np.float64) for c in ("_x", figure))
            panels.line(axes, x, y, str(outcome), {"color": colour}, **more)
    label = f"{figure} of every run against {', '.join(factors)}"
    return plot("factors", label, panels.figure)


def _along(values: pd.Series) -> tuple[Array, dict[str, Any]]:
    """Positions along an axis, and the axis; words are placed side by side, in order."""
    if pd.api.types.is_numeric_dtype(values) and values.dtype != bool:
        return values.to_numpy(dtype=np.float64), {}
    texts = values.astype(str).to_numpy()
    known, places = np.unique(texts, return_inverse=True)
    ticks = {"tickmode": "array", "tickvals": list(range(len(known))), "ticktext": known.tolist()}
    return places.astype(np.float64), ticks | {"range": [-0.5, len(known) - 0.5]}


def _make_room(panels: Panels, i: int, count: int) -> None:
    """Make room for the title of each panel's horizontal axis."""
    number = "" if i == 0 else str(i + 1)
    gap = 0.0 if count == 1 else min(0.22 / count, 0.5 / count)
    top = 1 - i / count
    panels.layout[f"yaxis{number}"]["domain"] = [max(0.0, top - 1 / count + gap), top]
