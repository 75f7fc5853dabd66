"""The page of the results, `docs/results/live_alarms.md`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .flights import AFTER_S, MAGNITUDES, SIZES

Row = Mapping[str, Any]
HEAD = """# Alarms while it flies

Written by `python -m benchmarks.live_alarms --out OUT --page docs/results/live_alarms.md`; the
flights by `python -m benchmarks.live_alarms --out OUT --jobs 2 --seeds SEEDS`, the recorded ones
by `--data DATA`.

`twin.explain.running.RunningEvidence` gets a flight second by second and says which effect has
begun, since when, by how much and with which probability. Flown by the three built-in vehicles in
closed loop (with drag of 0.3 1/s and a rotor lag of 20 ms where their files have none), along
random waypoints, in a wind of up to 3 m/s with turbulence of 0.1 to 0.5 m/s, sensors of medium
noise; plant and model are the same but for what begins, which it does 22 to 30 s after the start.
Sizes are those of the [hidden effects](hidden_effects.md). Settings were chosen on seeds 0 to 2
(some of the medium cases, and 12 minutes in which nothing begins) and not tried on
all of these again after the last change; the seeds here are others.

- *right*: the first alarm after the beginning has the name of what began by the end, 15 s later
- *at once*: it had this name when it was raised
- *delay*: from the beginning to the first alarm that has the name, over those that are right,
  with the second of a block and all buffers in it
"""
LIMITS = """
## What it cannot

- One change at a time: what begins within 15 s after another is not told apart from it.
- What the standing model lacks and a flight shows only later counts as begun by then. Ground effect
  is not in it: a landing may raise an alarm.
- A slower motor shows in manoeuvres alone, and is named once there are some.
- The strength of a vibration is told to a factor of two: the phases of the rotors are not known.
- Plant and model of the simulated flights are the same but for what begins. Recorded flights, where
  they are not, are few here, and short.
"""


@dataclass(frozen=True)
class Outcome:
    """Of one flight.

    Attributes:
        right: Whether what began was named by the end.
        at_once: Whether it was named when the alarm was raised.
        delay_s: Until it was named; infinity: never.
        name: Of the first alarm, by the end; "" for none.
        false: Alarms before anything had begun.
        further: Alarms beside the first one, after it.
    """

    right: bool
    at_once: bool
    delay_s: float
    name: str
    false: int
    further: int


def outcome(row: Row) -> Outcome:
    """What came of a flight in which something began."""
    begins_s = float(row["begins_s"])
    before = [a for a in row["alarms"] if a["raised_s"] < begins_s]
    after = [a for a in row["alarms"] if a["raised_s"] >= begins_s]
    if not after:
        return Outcome(False, False, np.inf, "", len(before), 0)
    names = after[0]["names"]
    named = [t for t, name in names if name == row["effect"]]
    right = bool(names[-1][1] == row["effect"])
    delay_s = named[0] - begins_s if right else np.inf
    at_once = after[0]["effect"] == row["effect"]
    return Outcome(right, at_once, delay_s, names[-1][1], len(before), len(after) - 1)


def page(rows: Sequence[Row]) -> str:
    """The whole page."""
    begun = [r for r in rows if r["effect"]]
    parts = [HEAD, *_summary(rows, begun), "## By effect\n", *_by_effect(begun)]
    parts += ["", "## Not named right\n", *_wrong(begun)]
    parts += ["", "## Nothing begins\n", *_quiet([r for r in rows if r["magnitude"] == "none"])]
    if real := [r for r in rows if r["magnitude"] == "real"]:
        parts += ["", "## Recorded flights\n", *_recorded(real)]
    return "\n".join([*parts, LIMITS.rstrip()]) + "\n"


def _summary(rows: Sequence[Row], begun: Sequence[Row]) -> Iterator[str]:
    quiet = [r for r in rows if r["magnitude"] == "none"]
    yield "| | goal | reached |"
    yield "|---|---|---|"
    for magnitude in ("medium", "large", "small"):
        out = [outcome(r) for r in begun if r["magnitude"] == magnitude]
        if out:
            right = sum(o.right for o in out)
            goal = "90 %" if magnitude == "medium" else "-"
            share = f"{right} of {len(out)} ({right / len(out):.0%})"
            yield f"| named right, {magnitude} | {goal} | {share} |"
            delays = [o.delay_s for o in out]
            middle = float(np.median(delays))
            goal = "3 s" if magnitude == "medium" else "-"
            said = f"{middle:.1f} s" if np.isfinite(middle) else "more than half are not named"
            yield f"| median delay, {magnitude}, not named counted as infinite | {goal} | {said} |"
    minutes = sum(r["seconds"] for r in quiet) / 60
    false = sum(len(r["alarms"]) for r in quiet)
    yield f"| false alarms in {minutes:.0f} minutes of quiet flights | 1 in 30 minutes | {false} |"
    early = sum(outcome(r).false for r in begun)
    spans = sum(max(r["seconds"] - AFTER_S, 0.0) for r in begun)
    yield f"| and before something begins, in {spans / 60:.0f} minutes | the same | {early} |"
    costs = [r["cost_s"] for r in rows if r["cost_s"] is not None]
    cost = 1e3 * float(np.median(costs))
    shown = f"{cost:.0f} ms, where it was flown"
    yield f"| processor per second of flight, {len(SIZES) + 1} effects | 100 ms | {shown} |"
    yield ""


def _by_effect(begun: Sequence[Row]) -> Iterator[str]:
    yield "| effect | " + " | ".join(f"{m}: right, at once, delay" for m in MAGNITUDES) + " |"
    yield "|---|" + "---|" * len(MAGNITUDES)
    for effect in SIZES:
        cells = []
        for m in MAGNITUDES:
            own = [r for r in begun if r["effect"] == effect and r["magnitude"] == m]
            out = [outcome(r) for r in own]
            delays = [o.delay_s for o in out if o.right]
            middle = f"{np.median(delays):.1f} s" if delays else "-"
            right, once = sum(o.right for o in out), sum(o.at_once for o in out)
            cells.append(f"{right} of {len(out)}, {once}, {middle}" if out else "-")
        yield f"| `{effect}` | " + " | ".join(cells) + " |"


def _wrong(begun: Sequence[Row]) -> Iterator[str]:
    wrong = [(r, outcome(r)) for r in begun if not outcome(r).right]
    if not wrong:
        yield "None."
        return
    yield "| effect | size | aircraft | seed | named |"
    yield "|---|---|---|---|---|"
    for r, o in wrong:
        seed = r["name"].rpartition("_")[2]
        named = f"`{o.name}`" if o.name else f"nothing within {AFTER_S:.0f} s"
        yield f"| `{r['effect']}` | {r['magnitude']} | {r['aircraft']} | {seed} | {named} |"


def _quiet(quiet: Sequence[Row]) -> Iterator[str]:
    yield "| flight | aircraft | minutes | alarms |"
    yield "|---|---|---|---|"
    for r in quiet:
        alarms = ", ".join(f"`{a['effect']}` at {a['raised_s']:.0f} s" for a in r["alarms"])
        minutes = f"{r['seconds'] / 60:.1f}"
        yield f"| {r['name']} | {r['aircraft']} | {minutes} | {alarms or 'none'} |"


def _recorded(real: Sequence[Row]) -> Iterator[str]:
    yield (
        "Each held against its aircraft as its other flights tell it, by the numbers of "
        "[real flights](real_flights.md): no days, no clocks, no smoothing of the pose. Nobody "
        "knows of anything that begins in these flights; each alarm is counted as false.\n"
    )
    yield "| flight | seconds looked at | alarms |"
    yield "|---|---|---|"
    for r in real:
        shown = [f"`{a['effect']}` since {a['since_s']:.1f} s" for a in r["alarms"]]
        yield f"| {r['name']} | {r['seconds']:.0f} | {', '.join(shown) or 'none'} |"
