"""Measures of answers against what was hidden: shares, medians, forecasts, errors of numbers.

Every (case, effect) with a probability is one forecast; it has come true where the effect was
hidden. Names that are neither right nor wrong (`Outcome.excused`) are left out, and flights after
a calibration.

The reliability diagram: an SVG that needs no script, no font and no network.
"""

import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from .cases import half_of

FAR = 2.0
"""A number of the file so many of its deviations off is one that may be named."""


@dataclass(frozen=True)
class Outcome:
    """One case: the truth and what was said about it."""

    truth: dict[str, Any]
    said: dict[str, Any]

    @property
    def kind(self) -> str:
        """single, pair, triple, outside, nothing, many, uncertain or since."""
        return str(self.truth["kind"])

    @property
    def hidden(self) -> set[str]:
        """Names of what was hidden."""
        return {e["name"] for e in self.truth["effects"]}

    @property
    def verdict(self) -> str:
        """What the program decided; "error" where it gave no answer."""
        return str(self.said["verdict"])

    @property
    def named(self) -> list[str]:
        """Effects that the program is sure of, the surest first; none unless the verdict is
        "named"."""
        if self.verdict != "named":
            return []
        unsure = self.said.get("undecided") or ()
        effects = sorted(self.said["effects"], key=lambda e: -e["probability"])
        return [e["name"] for e in effects if e["name"] not in unsure]

    @property
    def resembled(self) -> set[str]:
        """Effects that something acts like."""
        return {r["name"] for r in self.said.get("acts_like") or ()}

    @property
    def half(self) -> str:
        """tune or score."""
        happened = self.truth.get("class")
        names = self.hidden if happened is None else {happened} - {"none"}
        return half_of(self.truth["plant"], self.kind, names, self.truth.get("seed", 0))

    @property
    def lives(self) -> bool:
        """Whether it has what real aircraft have, and is no case of today."""
        return bool(self.truth.get("life"))

    @property
    def excused(self) -> set[str]:
        """Names that are neither right nor wrong: what puts a number of the file right that is far
        off, or days whose mean happens to be; and a late clock is never early, so that its days
        have a mean."""
        late = {"position_delay"} if self.truth.get("days") else set()
        late |= {e for e, z in self.truth.get("day_means", {}).items() if z > FAR}
        far = {e["effect"] for e in self.truth.get("file", ()) if abs(e["z"]) > FAR}
        return (late | far) - self.hidden

    def indistinguishable_from(self, name: str) -> set[str]:
        """Effects that the program says could stand for a name as well, the name with it; of one
        rotor or clock, "effect:part", the effect counts."""
        of_name = [e.get("one_of") or [] for e in self.said["effects"] if e["name"] == name]
        return {name} | {n.partition(":")[0] for names in of_name for n in names}

    @property
    def right(self) -> bool:
        """The first name of a single effect, all of several, or the right other verdict."""
        match self.kind:
            case "nothing" | "uncertain":
                return self.verdict == "nothing"
            case "outside":
                return self.verdict == "unnamed"
            case "pair" | "triple" | "many":
                return self.hidden <= set(self.named)
            case _:
                return self.named[:1] == [*self.hidden]

    @property
    def among_candidates(self) -> bool:
        """Whether everything hidden is among the effects listed or their rivals."""
        listed = self.said["effects"]
        rivals = {r["name"] for e in listed for r in e.get("rivals", [])}
        return self.hidden <= rivals | {e["name"] for e in listed}


def read_outcomes(
    results: Path, truth: Path, ids: Collection[str] | None = None
) -> tuple[list[Outcome], list[str]]:
    """Every case with a result, and the identifiers of those without one; default: all cases."""
    outcomes, missing = [], []
    for file in sorted(truth.glob("*.json")):
        if ids is not None and file.stem not in ids:
            continue
        said = results / file.name
        if said.is_file():
            outcomes.append(Outcome(json.loads(file.read_text()), json.loads(said.read_text())))
        else:
            missing.append(file.stem)
    return outcomes, missing


_Z95 = 1.959964


def rate(items: Sequence[Any], good: Callable[[Any], bool]) -> dict[str, Any]:
    """Share of the good ones, null where there are none."""
    return share(sum(map(good, items)), len(items))


def share(good: int, n: int) -> dict[str, Any]:
    """Share with its 95 % interval."""
    return {"value": good / n if n else None, "n": n, "good": good, "ci95": wilson(good, n)}


def wilson(good: int, n: int) -> list[float] | None:
    """95 % interval of a share. Source: Wilson, J. Am. Stat. Assoc. 22 (1927)."""
    if not n:
        return None
    p, z2 = good / n, _Z95**2 / n
    middle = (p + z2 / 2) / (1 + z2)
    half = _Z95 / (1 + z2) * math.sqrt(p * (1 - p) / n + z2 / (4 * n))
    low = 0.0 if good == 0 else middle - half
    return [low, 1.0 if good == n else middle + half]


def middle(values: Iterable[float]) -> dict[str, Any]:
    """Median with a 95 % interval by order statistics, null where there are too few for one."""
    finite = sorted(v for v in values if math.isfinite(v))
    n = len(finite)
    return {"value": median(finite) if finite else None, "n": n, "ci95": _around_median(finite)}


def _around_median(ordered: Sequence[float]) -> list[float] | None:
    """The narrowest pair of values, as far from either end, that holds the median in 95 %."""
    n, below, found = len(ordered), 0.0, None
    for k in range((n + 1) // 2):
        below += math.comb(n, k) / 2**n  # the median lies below value k
        if below > 0.025:
            break
        found = [ordered[k], ordered[n - 1 - k]]
    return found


ROTOR, _LOSS = "rotor_efficiency_loss", "loss_"
CLASSES = {
    "rotor": {ROTOR},
    "payload": {"mass_offset"},
    "slung": {"slung_load"},
    "accelerometer": {"accel_bias"},
    "gyroscope": {"gyro_bias"},
}
_MOVED = {"cog_offset", "inertia_error"}
"""They come with a payload and say nothing by themselves."""


def class_said(o: Outcome) -> str:
    """Class of the surest name; "none" where nothing was found, "other" where it has no class."""
    if o.verdict == "nothing":
        return "none"
    first = next((n for n in o.named if n not in _MOVED), "")
    return next((c for c, names in CLASSES.items() if first in names), "other")


def classes_said(o: Outcome) -> set[str]:
    """That class, and those of what cannot be told from the surest name."""
    first = next((n for n in o.named if n not in _MOVED), "")
    names = o.indistinguishable_from(first) if first else set()
    return {class_said(o)} | {c for c, of_class in CLASSES.items() if names & of_class}


def rotor_of(o: Outcome) -> int:
    """Number of the rotor that has lost thrust."""
    (effect,) = (e for e in o.truth["effects"] if e["name"] == ROTOR)
    (loss,) = effect["parameters"]
    return _number(loss)


def rotor_said(o: Outcome) -> int | None:
    """Number of the rotor with the largest loss that was named."""
    losses = [
        (float(p["value"]), _number(name))
        for e in o.said["effects"]
        if o.verdict == "named" and e["name"] == ROTOR
        for name, p in e["parameters"].items()
        if name.startswith(_LOSS)
    ]
    return max(losses)[1] if losses else None


def _number(name: str) -> int:
    """Of the rotor that a loss belongs to."""
    return int(name.removeprefix(_LOSS))


BINS = 10


@dataclass(frozen=True)
class Forecast:
    """How sure the program was of an effect, and whether it was hidden."""

    probability: float
    came_true: bool


def of_inclusion(outcomes: Sequence[Outcome]) -> list[Forecast]:
    """Of every candidate effect, named or not."""
    return [
        Forecast(p, name in o.hidden)
        for o in _without_since(outcomes)
        for name, p in (o.said.get("inclusion") or {}).items()
        if name not in o.excused
    ]


def of_names(outcomes: Sequence[Outcome]) -> list[Forecast]:
    """Of the effects that were named."""
    return [
        Forecast(e["probability"], e["name"] in o.hidden)
        for o in _without_since(outcomes)
        for e in o.said["effects"]
        if o.verdict == "named" and e["name"] not in o.excused
    ]


def _without_since(outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.kind != "since"]


def brier(forecasts: Sequence[Forecast]) -> float | None:
    """Mean square of probability minus outcome. Source: Brier, Monthly Weather Review 78 (1950)."""
    squares = [(f.probability - f.came_true) ** 2 for f in forecasts]
    return sum(squares) / len(squares) if squares else None


def reliability(forecasts: Sequence[Forecast]) -> list[dict[str, Any]]:
    """Mean probability and share that came true, by equally wide bins; empty ones left out."""
    bins: dict[int, list[Forecast]] = {}
    for f in forecasts:
        bins.setdefault(min(int(f.probability * BINS), BINS - 1), []).append(f)
    return [
        {
            "n": len(inside),
            "said": sum(f.probability for f in inside) / len(inside),
            "came_true": sum(f.came_true for f in inside),
        }
        for _, inside in sorted(bins.items())
    ]


def calibration_error(forecasts: Sequence[Forecast]) -> float | None:
    """Expected calibration error over the bins. Source: Naeini, Cooper & Hauskrecht, AAAI 2015."""
    off = [abs(b["said"] * b["n"] - b["came_true"]) for b in reliability(forecasts)]
    return sum(off) / len(forecasts) if forecasts else None


SIZE, MARGIN = 360, 50
_COLOURS = ("#1f5fbf", "#d9731a", "#3a8f4d")
_TICKS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
_FONT = 'font-family="Helvetica, Arial, sans-serif" font-size="12"'


def reliability_svg(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Share that came true over the probability that was said, with 95 % intervals.

    Args:
        curves: Bins of `chances.reliability` by what they are of.
    """
    whole = SIZE + 2 * MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole} {whole}" {_FONT}>',
        f'<rect width="{whole}" height="{whole}" fill="#ffffff"/>',
        _line(0, 0, 1, 1, "#b9c0cc", dashed=True),
        _line(0, 0, 1, 0, "#1a1d29"),
        _line(0, 0, 0, 1, "#1a1d29"),
    ]
    for tick in _TICKS:
        parts.append(_text(_x(tick), _y(0) + 18, f"{tick:g}", "middle"))
        parts.append(_text(_x(0) - 8, _y(tick) + 4, f"{tick:g}", "end"))
    parts.append(_text(_x(0.5), whole - 12, "probability that was said", "middle"))
    turn = f'transform="rotate(-90 14 {_y(0.5):.1f})"'
    parts.append(_text(14, _y(0.5), "share of effects that were hidden", "middle", turn))
    for i, (name, bins) in enumerate(curves.items()):
        colour = _COLOURS[i % len(_COLOURS)]
        parts.append(_text(_x(0.04), _y(0.96 - 0.06 * i), name, "start", f'fill="{colour}"'))
        points = [(b["said"], b["came_true"] / b["n"]) for b in bins]
        path = " ".join(f"{_x(p):.1f},{_y(q):.1f}" for p, q in points)
        parts.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>'
        )
        for (p, q), b in zip(points, bins, strict=True):
            low, high = wilson(b["came_true"], b["n"]) or (q, q)
            parts.append(_line(p, low, p, high, colour))
            parts.append(
                f'<circle cx="{_x(p):.1f}" cy="{_y(q):.1f}" r="4" fill="{colour}">'
                f"<title>{b['came_true']} of {b['n']}</title></circle>"
            )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _x(value: float) -> float:
    return MARGIN + SIZE * value


def _y(value: float) -> float:
    return MARGIN + SIZE * (1 - value)


def _line(x0: float, y0: float, x1: float, y1: float, colour: str, dashed: bool = False) -> str:
    dash = ' stroke-dasharray="5 4"' if dashed else ""
    return (
        f'<line x1="{_x(x0):.1f}" y1="{_y(y0):.1f}" x2="{_x(x1):.1f}" y2="{_y(y1):.1f}" '
        f'stroke="{colour}"{dash}/>'
    )


def _text(x: float, y: float, words: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{words}</text>'


CLEAR = 1.1
"""A gap counts when it is larger than its noise floor by this factor."""


@dataclass(frozen=True)
class ParameterError:
    """One number.

    Attributes:
        name: "effect.number".
        relative: Error over the size of the hidden vector, measured from where nothing is hidden.
        covered: Whether the 95 % interval holds the truth.
        exact: Whether plant and library share the law, so that the same number is meant.
    """

    name: str
    relative: float
    covered: bool
    exact: bool


def parameter_errors(
    truth: dict[str, Any], said: dict[str, Any], named: Collection[str]
) -> Iterator[ParameterError]:
    """Errors of the numbers of effects rightly named: same name, same unit, with an interval.

    Numbers without an interval are shapes, such as a reference or a height: no magnitude.
    """
    given = {e["name"]: e["parameters"] for e in said["effects"] if e["name"] in named}
    for effect in truth["effects"]:
        for name, number in effect["parameters"].items():
            found = given.get(effect["name"], {}).get(name)
            if found is None or _plain(found["unit"]) != _plain(number["unit"]):
                continue
            interval, size = found.get("ci95"), _size(effect["parameters"], number["unit"])
            if size > 0 and interval is not None and None not in interval:
                yield ParameterError(
                    f"{effect['name']}.{name}",
                    abs(found["value"] - number["value"]) / size,
                    bool(interval[0] <= number["value"] <= interval[1]),
                    number["exact"],
                )


def share_closed(o: Outcome) -> float:
    """Share of what stood above the noise floor that is gone: mean of the channels with a gap."""
    shares = [(c["before"] - c["after"]) / (c["before"] - c["noise_floor"]) for c in _gaps(o)]
    return sum(shares) / len(shares) if shares else math.nan


def after_over_floor(o: Outcome, after: str = "after") -> float:
    """Gap afterwards over the noise floor: root mean square of the channels that had a gap.

    Args:
        o: One case.
        after: "after", or "on_its_day" for the constants of the day set apart.
    """
    return _root_mean_square([c[after] / c["noise_floor"] for c in _gaps(o)])


def after_over_fit_mean(o: Outcome) -> float:
    """Gap afterwards over what the mean of the fit flights' residual leaves, over the channels that
    had a gap."""
    return _root_mean_square([c["after"] / c["fit_mean"] for c in _gaps(o) if c["fit_mean"]])


def _root_mean_square(ratios: Collection[float]) -> float:
    return math.sqrt(sum(r * r for r in ratios) / len(ratios)) if ratios else math.nan


def _gaps(o: Outcome) -> Iterator[dict[str, Any]]:
    """Every channel that stood above its noise floor."""
    for channel in o.said.get("gap", {}).values():
        if channel["before"] > CLEAR * channel["noise_floor"] > 0:
            yield channel


def _size(parameters: dict[str, Any], unit: str) -> float:
    """Length of the vector of all numbers of one unit, from their neutral values."""
    same = [p["value"] - p["neutral"] for p in parameters.values() if p["unit"] == unit]
    return math.sqrt(sum(v * v for v in same))


def _plain(unit: str) -> str:
    """One spelling: `kg.m2`, `kg*m^2` and `kg·m²` are the same."""
    for old, new in (("²", "2"), ("³", "3"), ("^", ""), ("*", "."), ("·", ".")):
        unit = unit.replace(old, new)
    return unit
