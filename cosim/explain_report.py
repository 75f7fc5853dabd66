"""The page that `uavtwin explain` leaves: one sentence, the picture that convinces, the proof."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from twin.effects import EFFECTS
from twin.explain.explanation import Explanation
from twin.explain.numbers import numbers_of
from twin.explain.result_json import beside_mean, best_with, listed, rivals
from twin.explain.unsteady_effect import Unsteady

from .explain_figures import before_after_figure, evidence_figure
from .explain_words import (
    certainty,
    claim,
    interval,
    meaning,
    shrink_words,
    shrinking,
    title,
    why_lost,
)
from .figures import embedded, pretty_unit
from .page import render
from .report import number, percent

MOST_AFFECTED = 2
"""Channels that are drawn over time."""


def write_explain_report(found: Explanation, path: Path) -> None:
    """Write the page; the same findings give the same bytes.

    Args:
        found: What was found.
        path: HTML file to write; an existing one is replaced.
    """
    page = render(
        "explain.html.j2",
        {
            "number": number,
            "percent": percent,
            "unit": pretty_unit,
            "shrink_words": shrink_words,
        },
        claim=claim(found),
        found=found,
        shrinking=shrinking(found),
        effects=[_effect(found, e) for e in listed(found)],
        before_after=_before_after(found),
        gaps=() if found.showing is None else found.showing.gaps,
        stable=all(m.stable for m in found.missions),
    )
    path.write_text(page, encoding="utf-8")


def _effect(found: Explanation, effect: str) -> dict[str, Any]:
    """One effect as the template reads it."""
    assert found.naming is not None
    beside = beside_mean(found, effect)
    if beside is not None:
        return _unsteady(found, beside)
    fitted = best_with(found.naming, effect)
    acts = next((a for a in found.acting if a.effect == effect), None)
    about = {n.full: n for n in found.naming.ground.model.numbers}
    figure: Mapping[str, Any] | None = None
    if acts is not None and found.showing is not None:
        drawn = evidence_figure(acts, found.showing.after)
        figure = _figure(f"evidence-{effect}", drawn)
    return {
        "name": title(effect),
        "meaning": meaning(effect),
        "certainty": certainty(found.naming.probability_of(effect)),
        "numbers": [
            {
                "name": about[full].name,
                "description": about[full].about.description,
                "unit": about[full].about.unit,
                "value": value,
                "interval": interval(fitted, full),
            }
            for full, value in fitted.values.items()
            if about[full].effect == effect
        ],
        "acts": acts,
        "figure": figure,
        "rivals": [
            {
                "name": title(r["name"]),
                "meaning": meaning(r["name"]),
                "certainty": certainty(r["probability"]),
                "why": why_lost(r),
            }
            for r in rivals(found.naming, effect)
        ],
    }


def _unsteady(found: Explanation, effect: Unsteady) -> dict[str, Any]:
    """An effect that changes no mean, as the template reads it."""
    about = {n.full: n for n in numbers_of([EFFECTS[effect.effect]], found.vehicle)}
    return {
        "name": title(effect.effect),
        "meaning": meaning(effect.effect),
        "certainty": certainty(effect.probability),
        "numbers": [
            {
                "name": about[full].name,
                "description": about[full].about.description,
                "unit": about[full].about.unit,
                "value": value,
                "interval": " to ".join(map(number, effect.intervals[full]))
                if full in effect.intervals
                else "\N{EN DASH}",
            }
            for full, value in effect.values.items()
        ],
        "acts": {"channels": effect.channels, "phases": ()},
        "figure": None,
        "rivals": [],
    }


def _before_after(found: Explanation) -> list[dict[str, Any]]:
    """Figures over time of the most affected channels."""
    showing = found.showing
    if showing is None or not found.values:
        return []
    names = list(dict.fromkeys(c for a in found.acting for c in a.channels[:MOST_AFFECTED]))
    flights = [f.flight.name for f in showing.model.flights]
    figures = []
    for name in names[: 2 * MOST_AFFECTED]:
        before, after = (
            [next(c for c in flight if c.name == name) for flight in channels]
            for channels in (showing.before, showing.after)
        )
        figures.append(_figure(f"time-{name}", before_after_figure(name, before, after, flights)))
    return figures


def _figure(name: str, figure: Any) -> dict[str, Any]:
    json: Markup = embedded(figure)
    return {"id": name, "height": int(figure.layout.height), "json": json}
