"""The page that `uavtwin explain` leaves: one sentence, the picture that convinces, the proof."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from twin.explain.estimates import estimates_of, listed_effects, probability_of, rivals, where_felt
from twin.explain.explanation import Explanation

from .explain_figures import before_after_figure, evidence_figure
from .figures import embedded, pretty_unit
from .gap import number, percent
from .page import render
from .words import (
    by_prior,
    calibrated_rows,
    certainty,
    claim,
    day_rows,
    instead,
    interval,
    meaning,
    shrink_words,
    shrinking,
    title,
    why_lost,
)

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
        effects=[_effect(found, e) for e in listed_effects(found)],
        before_after=_before_after(found),
        gaps=() if found.comparison is None else found.comparison.gaps,
        alike=[] if found.naming is None else found.naming.resemblances,
        calibrated=calibrated_rows(found),
        days=day_rows(found),
        stable=all(m.stable for m in found.missions),
    )
    path.write_text(page, encoding="utf-8")


def _effect(found: Explanation, effect: str) -> dict[str, Any]:
    """One effect as the template reads it."""
    channels, phases = where_felt(found, effect)
    acts = next((a for a in found.attributions if a.effect == effect), None)
    figure: Mapping[str, Any] | None = None
    if acts is not None and found.comparison is not None:
        drawn = evidence_figure(acts, found.comparison.after)
        figure = _figure(f"evidence-{effect}", drawn)
    return {
        "name": title(effect),
        "meaning": meaning(effect),
        "certainty": certainty(probability_of(found, effect)),
        "numbers": [
            {
                "name": t.number.name,
                "description": t.number.about.description,
                "unit": t.number.about.unit,
                "value": t.value,
                "interval": interval(t.ci95),
                "told_by": by_prior(found, t.prior_share),
            }
            for t in estimates_of(found, effect)
        ],
        "instead": instead(found, effect),
        "channels": channels,
        "phases": phases,
        "figure": figure,
        "rivals": [
            {
                "name": title(r["name"]),
                "meaning": meaning(r["name"]),
                "certainty": certainty(r["probability"]),
                "why": why_lost(r, found.settings.inference),
            }
            for r in rivals(found, effect)
        ],
    }


def _before_after(found: Explanation) -> list[dict[str, Any]]:
    """Figures over time of the most affected channels."""
    comparison = found.comparison
    if comparison is None or not found.values:
        return []
    names = list(dict.fromkeys(c for a in found.attributions for c in a.channels[:MOST_AFFECTED]))
    flights = [f.flight.name for f in comparison.model.flights]
    figures = []
    for name in names[: 2 * MOST_AFFECTED]:
        before, after = (
            [next(c for c in flight if c.name == name) for flight in channels]
            for channels in (comparison.before, comparison.after)
        )
        figures.append(_figure(f"time-{name}", before_after_figure(name, before, after, flights)))
    return figures


def _figure(name: str, figure: Any) -> dict[str, Any]:
    json: Markup = embedded(figure)
    return {"id": name, "height": int(figure.layout.height), "json": json}
