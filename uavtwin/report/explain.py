"""The page that `uavtwin explain` leaves: one sentence, the picture that convinces, the proof."""

from pathlib import Path
from typing import Any

from twin.effects import EFFECTS, RandomForce
from twin.explain.estimates import (
    channels_and_phases,
    estimates_of,
    listed_effects,
    probability_of,
    rivals,
    stochastic_effect,
)
from twin.explain.explanation import Explanation

from ..formatting import certainty, number, number_cells, percent, pretty_unit, title
from ..headline import got_worse, headline
from ..wording import hover_sentence
from .autopilot import Strip, autopilot_content, strip
from .drawing import Budget, fitted
from .evidence import (
    before_after_figure,
    phases_of,
    steady_evidence,
    time_group,
    unsteady_evidence,
    unsteady_strip,
)
from .overview import flight_spans, overview, overview_plots
from .page import Plot, plot, render
from .words import (
    by_prior,
    calibrated_rows,
    day_rows,
    instead,
    meaning,
    shrink_words,
    shrinking,
    why_lost,
)

MOST_AFFECTED = 2
"""Channels of an effect that are drawn over time."""


def write_explain_report(found: Explanation, path: Path) -> None:
    """Write the page; the same findings give the same bytes.

    Args:
        found: What was found.
        path: HTML file to write; an existing one is replaced.
    """
    path.write_text(fitted(lambda budget: _page(found, budget)), encoding="utf-8")


def _page(found: Explanation, budget: Budget) -> str:
    """Text of the page."""
    listed = sorted(listed_effects(found), key=lambda e: not EFFECTS[e].in_the_air)
    return render(
        "explain.html.j2",
        {
            "number": number,
            "percent": percent,
            "unit": pretty_unit,
            "shrink_words": shrink_words,
        },
        claim=headline(found).text,
        got_worse=got_worse(found),
        hover=[f"{h.flight}: {hover_sentence(found.vehicle.name, h)}" for h in found.hovers],
        found=found,
        shrinking=shrinking(found),
        effects=[_effect(found, e, budget) for e in listed],
        flight=_flight(found, budget),
        strips=_strips(found),
        before_after=_before_after(found, budget),
        gaps=() if found.comparison is None else found.comparison.gaps,
        alike=[] if found.naming is None else found.naming.resemblances,
        calibrated=calibrated_rows(found),
        days=day_rows(found),
        stable=all(m.stable for m in found.missions),
    )


def _effect(found: Explanation, effect: str, budget: Budget) -> dict[str, Any]:
    """One effect as the template reads it."""
    channels, phases = channels_and_phases(found, effect)
    figures, how, over = _evidence(found, effect, budget)
    return {
        "name": title(effect),
        "meaning": meaning(effect),
        "certainty": certainty(probability_of(found, effect)),
        "numbers": [
            {
                "name": t.number.name,
                "description": t.number.about.description,
                **dict(
                    zip(
                        ("value", "unit", "interval"),
                        number_cells(t.value, t.number.about.unit, t.ci95),
                        strict=True,
                    )
                ),
                "informed_by": by_prior(found, t.prior_share),
            }
            for t in estimates_of(found, effect)
        ],
        "instead": instead(found, effect),
        "channels": channels,
        "phases": phases,
        "figures": figures,
        "how": how,
        "strip": over,
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


def _flight(found: Explanation, budget: Budget) -> dict[str, Any]:
    """The last recorded flight, held out where one was: its track, motors and battery."""
    if not found.recorded:
        return {"name": "", "track": [], "logged": None, "view": None}
    flight = found.recorded[-1]
    phases = flight_spans(flight)
    shown = overview(flight)
    track, logged = overview_plots("flight", shown, phases, budget)
    view = autopilot_content("flight", shown.view, phases, budget)
    return {"name": flight.name, "track": track, "logged": logged, "view": view}


def _strips(found: Explanation) -> list[Strip]:
    """Modes and events of the held-out flights, whose time axes carry residuals."""
    flights = () if found.comparison is None else found.comparison.model.flights
    strips = [
        strip(time_group(i), f.flight.autopilot, float(f.flight.time_s[-1]))
        for i, f in enumerate(flights)
    ]
    return [s for s in strips if s is not None]


def _evidence(
    found: Explanation, effect: str, budget: Budget
) -> tuple[list[Plot], str, Strip | None]:
    """Figures that convince of an effect, how to read them, and the strip over them if it is not
    one of the page; no figures where there is nothing."""
    acts = next((a for a in found.attributions if a.effect == effect), None)
    compared = found.comparison
    if acts is not None and compared is not None:
        return *steady_evidence(acts, compared.after, compared.model.flights, budget), None
    unsteady = stochastic_effect(found, effect)
    recorded = [] if unsteady is None else [f for f in found.recorded if f.has(*unsteady.channels)]
    if unsteady is None or not recorded:
        return [], "", None
    if compared is None or not isinstance(EFFECTS[effect].observable_as, RandomForce):
        shown = unsteady_evidence(unsteady, recorded[-1], (), found.vehicle, budget)
        return *shown, unsteady_strip(effect, recorded[-1])
    flight = compared.model.flights[0].flight
    shown = unsteady_evidence(unsteady, flight, compared.after[0], found.vehicle, budget)
    return *shown, unsteady_strip(effect, flight)


def _before_after(found: Explanation, budget: Budget) -> list[Plot]:
    """Figures over time of the most affected channels."""
    compared = found.comparison
    if compared is None or not found.values:
        return []
    names = list(dict.fromkeys(c for a in found.attributions for c in a.channels[:MOST_AFFECTED]))
    figures = []
    for name in names[: 2 * MOST_AFFECTED]:
        for i, flight in enumerate(compared.model.flights):
            before, after = (
                next(c for c in channels[i] if c.name == name)
                for channels in (compared.before, compared.after)
            )
            spans = phases_of(flight)
            figure = before_after_figure(before, after, spans, time_group(i), budget)
            label = f"{name} of {flight.flight.name}, before and after, over time"
            figures.append(plot(f"time-{name}-{i}", label, figure))
    return figures
