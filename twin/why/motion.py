"""Events of the body as records: a failed rotor, a change of mass, a push, a gust."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import cast

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from .body import Body
from .causes import BLOW, CAUSES, CUT, LOSSES, NOTHING, ROTOR
from .competition import AFTER_S, BEFORE_S, SHOWN_GUST_S, Competition, Onset
from .findings import Findings
from .flight import Airborne, FlightFrame
from .records import Amount, Candidate, Event, EvidenceSeries, NotVisible, Severity
from .speeds import CHECKS, speed_of

LEAST_S = 8.0
"""Shortest part in the air that is searched for events of the body."""
STRETCH_S = 150.0
"""Length of stretches into which longer parts are divided, each with preceding data."""
SHOWN_S = (2.0, 1.5)
"""Times before and after an onset that a page displays."""
LISTED = 0.02
"""Smallest probability of a reported alternative."""
REFINED_S, STEP_S, BEND_S = 0.15, 0.004, 0.05
"""Range and step of the refinement of an onset, and length of data before and after it for the
rate."""


def moved(frame: FlightFrame, references: Sequence[FlightFrame] = ()) -> Findings:
    """Findings on what moved the body apart from its commands."""
    missing = [s for s in ("gyro", "acc") if s not in frame.grid]
    if frame.drive is None or frame.layout is None or missing:
        lacking = ", ".join(missing) or "motor commands whose rotors are known"
        return Findings(not_visible=[_hidden(c, None, f"the log has no {lacking}") for c in CAUSES])
    events, nothing, shown = [], 1.0, []
    hidden: list[NotVisible] = []
    for body, first in _bodies(frame):
        if body.unanswered:
            hidden += _unseen(body, first)
            continue
        competition = Competition(body)
        shown.append(competition.shown())
        for onset in competition.onsets():
            if body.t_s[onset.place] >= first:
                events.append(event_of(body, onset))
                nothing *= 1.0 - events[-1].probability
    if shown:
        lost, gusts = map(np.concatenate, zip(*shown, strict=True))
        hidden += [least_loss(lost, frame.rate_hz(frame.drive)), *_least_gust(gusts)]
    elif not hidden:
        reason = f"the log has no {LEAST_S:g} s in the air"
        hidden = [_hidden(cause, None, reason) for cause in CAUSES if cause != CUT]
    return Findings(
        events=events,
        nothing=nothing,
        not_visible=hidden,
        notes=[f"rotors: {frame.layout.source}"],
    )


def least_loss(nats: NDArray[np.float64], rate_hz: float) -> NotVisible:
    """The smallest loss of a rotor that passes its level at half of the onsets, or at as many as
    any loss does.

    Args:
        nats: Nats from `Competition.shown`, of all stretches.
        rate_hz: Rate of the commands.
    """
    passes = (nats > 0).mean(axis=0) if len(nats) else np.zeros(len(LOSSES))
    share = min(0.5, float(passes.max()))
    if share == 0.0:
        noisy = f"with commands at {rate_hz:.0f} Hz no loss stands out of the noise"
        return _hidden(ROTOR, None, noisy)
    least = float(LOSSES[np.argmax(passes >= share)])
    if share < 0.5:
        noisy = "in the rest of it none stands out of the noise"
        return replace(_hidden(ROTOR, least, noisy), share=share)
    return _hidden(ROTOR, least, "a smaller one does not stand out of the noise")


def _least_gust(sizes: NDArray[np.float64]) -> Iterator[NotVisible]:
    """The smallest gust that passes its level at half of the onsets, by its force.

    Args:
        sizes: Gusts from `Competition.shown`, of all stretches, m/s^2.
    """
    if len(sizes):
        reason = (
            f"wind shakes as much; of a gust of {SHOWN_GUST_S:g} s, mass times this is its force"
        )
        yield _hidden(BLOW, float(np.median(sizes)), reason, "m/s^2")


def _unseen(body: Body, first_s: float) -> Iterator[NotVisible]:
    """Causes that a stretch does not show, and the reason."""
    begin, end = max(first_s, float(body.t_s[0])), float(body.t_s[-1])
    reason = f"from {begin:.0f} to {end:.0f} s {body.unanswered}"
    yield from (_hidden(cause, None, reason) for cause in CAUSES if cause != CUT)


def _bodies(frame: FlightFrame) -> tuple[tuple[Body, float], ...]:
    """Stretches of all parts in the air, and the time from which events of each are counted, s;
    cached with the frame, since two finders need them."""
    if "bodies" not in frame.cache:
        parts = [p for p in frame.airborne if (p.flown - p.start) * frame.dt_s >= LEAST_S]
        found = ((Body.of(frame, s), t) for p in parts for s, t in _stretches(frame, p))
        frame.cache["bodies"] = tuple(found)
    return cast(tuple[tuple[Body, float], ...], frame.cache["bodies"])


def misnumbered(frame: FlightFrame) -> bool:
    """Whether the motors have other numbers than assumed, or that is not known."""
    return any(body.misnumbered for body, _ in _bodies(frame))


def _stretches(frame: FlightFrame, part: Airborne) -> Iterator[tuple[Airborne, float]]:
    """A part in stretches of at most `STRETCH_S`, each extended by preceding data."""
    length = (part.flown - part.start) * frame.dt_s
    count = max(1, int(np.ceil((length - BEFORE_S) / (STRETCH_S - BEFORE_S))))
    edges = np.linspace(part.start, part.flown, count + 1).astype(int)
    for k, (start, end) in enumerate(pairwise(edges.tolist())):
        last = k == count - 1
        early = max(start - frame.places(BEFORE_S), part.start) if k else start
        until = part.end if last else min(end + frame.places(AFTER_S), part.flown)
        piece = Airborne(early, until, part.lost, part.crash) if last else Airborne(early, until)
        yield piece, float(frame.t_s[start]) if k else 0.0


def event_of(body: Body, onset: Onset) -> Event:
    """Record of an event of the competition."""
    name, (_, probability) = onset.name, onset.probabilities[0]
    onset_s = float(body.t_s[onset.place] - body.frame.dt_s / 2)
    if name.cause == ROTOR and len(name.rotors) == 1 and not name.grows:
        onset_s = refined_onset(body, onset_s, name.rotors[0] - 1)
    severity, cause = _severity(onset), CAUSES[name.cause]
    words = {
        "rotor": " and ".join(map(str, name.rotors)),
        "t": f"{onset_s:.2f}",
        "value": "" if severity is None else f"{100 * severity.value:.0f} %",
    }
    grown = f", growing for {onset.grows_s:g} s" if onset.grows_s else ""
    speed = None
    if name.cause == ROTOR and len(name.rotors) == 1 and severity is not None:
        speed = speed_of(body.frame, name.rotors[0], onset_s, severity.value)
    check = CHECKS[speed.tells] if speed is not None else ""
    return Event(
        cause=name.cause,
        rotor=name.rotors or None,
        onset_s=onset_s,
        severity=severity,
        probability=probability,
        alternatives=_alternatives(onset),
        text=cause.text.format(**words) + grown,
        bench_check=(check or cause.check).format(**words),
        evidence=tuple(_evidence(body, onset_s)),
    )


def _severity(onset: Onset) -> Severity | None:
    if not onset.sizes:
        return None
    low, value, high = (onset.quantile(q) for q in (0.05, 0.5, 0.95))
    quantity = CAUSES[onset.name.cause].quantity
    return Severity(quantity=quantity, value=value, low=low, high=high, unit="1")


def _alternatives(onset: Onset) -> tuple[Candidate, ...]:
    return tuple(
        Candidate(cause=n.cause, rotor=n.rotors or None, probability=p)
        for n, p in onset.probabilities[1:]
        if p > LISTED and n.cause != NOTHING
    )


def refined_onset(body: Body, onset_s: float, rotor: int) -> float:
    """Time at which the body begins to rotate away from a rotor: the sharpest bend of its rate
    along the rotor's moment, in the logged readings."""
    gyro = body.frame.signals["gyro"]
    if gyro.rate_hz < 2 / BEND_S:
        return onset_s
    away = -body.signs[1:, rotor] * np.array([1.0, 1.0, 0.0])
    half = max(REFINED_S, body.frame.dt_s)
    tried = np.arange(onset_s - half, onset_s + half, STEP_S)
    before, now, after = (
        np.interp(tried + k * BEND_S, gyro.t_s, gyro.values @ away) for k in (-1, 0, 1)
    )
    return float(tried[int(np.argmax(after - 2 * now + before))])


def _evidence(body: Body, onset_s: float) -> Iterator[EvidenceSeries]:
    """Specific force and rotation, measured and expected from the commands by the normal part."""
    shown = (body.t_s > onset_s - SHOWN_S[0]) & (body.t_s < onset_s + SHOWN_S[1])
    t = tuple(body.t_s[shown].tolist())
    expected = body.expected()
    names = ("specific force z", "angular acceleration x", "angular acceleration y")
    for j, (name, unit) in enumerate(zip(names, ("m/s^2", "rad/s^2", "rad/s^2"), strict=True)):
        yield EvidenceSeries(
            name=name,
            unit=unit,
            t_s=t,
            measured=tuple(body.measured[shown, j].tolist()),
            expected=tuple(expected[shown, j].tolist()),
        )


def _hidden(cause: str, value: float | None, reason: str, unit: str = "1") -> NotVisible:
    least = Amount(value=value, unit=unit)
    return NotVisible(cause=cause, smallest_detectable=least, reason=reason)
