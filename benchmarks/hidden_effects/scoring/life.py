"""Figures of the cases that have what real aircraft have."""

from collections.abc import Iterator, Sequence
from typing import Any

from .chances import brier, calibration_error, of_inclusion, of_names
from .happened import class_said, classes_said, rotor_of, rotor_said
from .measures import ParameterError, after_over_fit_mean, after_over_floor, parameter_errors
from .outcomes import FAR, Outcome
from .rates import middle, rate, share

CLEAR = 2.0
"""An effect counts where it is larger than so many of its deviations."""
_Z95 = 1.959964
_FAMILY = {"rotor_drag", "blade_flapping"}
"""Drag of the rotors with a height: with one of them free in its law, many effects at once do not
tell one from the other."""


def life_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """A line for each figure; a value is null where no case counts for it."""
    lives = [o for o in outcomes if o.lives]
    many, uncertain, since = (
        [o for o in lives if o.kind == k] for k in ("many", "uncertain", "since")
    )
    sound = [o for o in uncertain if all(abs(e["z"]) <= FAR for e in o.truth["file"])]
    errors = [e for o in many for e in _errors(o) if e.exact]
    rows: list[tuple[str, dict[str, Any]]] = [
        ("many: recall of effects over twice their deviation", share(*_recall(many))),
        ("  with what something acts like", share(*_recall(many, resembled=True))),
        ("many: precision of names", share(*_precision(many))),
        ("many: numbers inside their 95 % interval", rate(errors, lambda e: bool(e.covered))),
        ("many: held-out gap over noise floor, median", middle(after_over_floor(o) for o in many)),
        (
            "  with the constants of its day",
            middle(after_over_floor(o, "on_its_day") for o in many),
        ),
        ("many: held-out gap over that of the fit mean", middle(map(after_over_fit_mean, many))),
        ("uncertain: nothing beyond the file", rate(uncertain, _quiet)),
        ("  no number of the file over twice its sd off", rate(sound, _quiet)),
        ("calibrated numbers inside their interval", share(*_calibrated([*many, *uncertain]))),
        *_by_condition(lives),
        *_since(since),
        *_chances(outcomes),
        (
            "seconds per case, median, as in life",
            middle(o.said["seconds"] for o in lives if "seconds" in o.said),
        ),
    ]
    return [{"what": what, **value} for what, value in rows]


def _by_condition(lives: Sequence[Outcome]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Single effects that show, and quiet flights, by what is special about them."""
    groups = {
        "days": "days that differ",
        "rotors": "measured rotor speeds",
        "without": "missing sensors",
    }
    for key, what in groups.items():
        there = [o for o in lives if o.truth["life"][key] and o.kind in ("single", "nothing")]
        material = [o for o in there if o.kind == "single" and o.hidden <= {*o.truth["material"]}]
        quiet = [o for o in there if o.kind == "nothing"]
        yield f"{what}: right name first", rate(material, _first)
        yield f"{what}: quiet flights", rate(quiet, _quiet)


def _since(since: Sequence[Outcome]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What has happened to a calibrated aircraft."""
    rotors = [o for o in since if o.truth["class"] == "rotor"]
    normal = [o for o in since if o.truth["class"] == "none"]
    for what, slow in (("since", None), ("  slow flights", True), ("  fast flights", False)):
        part = [o for o in since if slow is None or o.truth["life"]["slow"] is slow]
        yield f"{what}: class right", rate(part, lambda o: class_said(o) == o.truth["class"])
    yield (
        "  or among what cannot be told from it",
        rate(since, lambda o: o.truth["class"] in classes_said(o)),
    )
    yield "since: right rotor", rate(rotors, lambda o: rotor_said(o) == rotor_of(o))
    yield "since: normal flights quiet", rate(normal, lambda o: class_said(o) == "none")


def _chances(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Whether probabilities are what they say, today's cases with them."""
    for what, forecasts in (
        ("all candidates", of_inclusion(outcomes)),
        ("names", of_names(outcomes)),
    ):
        for figure, value in (
            ("Brier score", brier(forecasts)),
            ("expected calibration error", calibration_error(forecasts)),
        ):
            yield f"{figure}, {what}", {"value": value, "n": len(forecasts), "ci95": None}


def _recall(many: Sequence[Outcome], resembled: bool = False) -> tuple[int, int]:
    """Found ones of the hidden effects that count; `resembled`: those that something acts like,
    being farther from what is expected than a name may be, are found as well."""
    found = [
        _is_found(o, n) or (resembled and n in o.resembled)
        for o in many
        for n in sorted(o.hidden)
        if _counts(o, n)
    ]
    return sum(found), len(found)


def _counts(o: Outcome, name: str) -> bool:
    """Whether a hidden effect was to be found: where it was named, by its own interval; where it
    was not, if it shows in the readings."""
    hidden, given = _numbers(o, name), _given(o, name)
    clear = [
        abs(hidden[k]["value"] - hidden[k]["neutral"]) * 2 * _Z95 / (high - low)
        for k, (low, high) in given.items()
        if k in hidden and high > low
    ]
    return max(clear) > CLEAR if clear else name in o.truth["material"]


def _is_found(o: Outcome, name: str) -> bool:
    """Named, or one of those that a name cannot be told from, or a number that was calibrated away
    from where nothing is hidden."""
    if any(name in _stands_for(o, n) for n in o.named):
        return True
    hidden = _numbers(o, name)
    return any(
        effect == name and not any(low <= n["neutral"] <= high for n in hidden.values())
        for effect, _, (low, high) in _intervals_of_file(o)
    )


def _intervals_of_file(o: Outcome) -> Iterator[tuple[str, str, tuple[float, float]]]:
    """Effect, number and interval of everything that lacks nothing beyond the file's own `sd`."""
    for entry in o.said.get("calibrated") or ():
        for name, number in entry["parameters"].items():
            if number["ci95"] and None not in number["ci95"]:
                yield entry["effect"], name, tuple(number["ci95"])


def _precision(many: Sequence[Outcome]) -> tuple[int, int]:
    """Names that were hidden, or cannot be told from one that was, of all that count."""
    said = [(o, n) for o in many for n in o.named if n not in o.excused]
    return sum(bool(_stands_for(o, n) & o.hidden) for o, n in said), len(said)


def _stands_for(o: Outcome, name: str) -> set[str]:
    """Effects that count as said with a name."""
    return o.indistinguishable_from(name) | (_FAMILY if name in _FAMILY else set())


def _errors(o: Outcome) -> Iterator[ParameterError]:
    """Of the numbers of effects rightly named, seen from the file."""
    effects = [{**e, "parameters": _numbers(o, e["name"])} for e in o.truth["effects"]]
    return parameter_errors({**o.truth, "effects": effects}, o.said, o.named)


def _calibrated(outcomes: Sequence[Outcome]) -> tuple[int, int]:
    """Of the numbers of the file that were calibrated, with their truth known."""
    inside = []
    for o in outcomes:
        for effect, name, (low, high) in _intervals_of_file(o):
            truth = o.truth["seen_from_file"].get(effect, {}).get(name)
            if truth is not None:
                inside.append(low <= truth["value"] <= high)
    return sum(inside), len(inside)


def _numbers(o: Outcome, name: str) -> dict[str, Any]:
    """Of a hidden effect: what differs from the file, its own error with it."""
    effect = next(e for e in o.truth["effects"] if e["name"] == name)
    seen: dict[str, Any] = o.truth["seen_from_file"].get(name, {})
    return {**effect["parameters"], **seen}


def _given(o: Outcome, name: str) -> dict[str, tuple[float, float]]:
    """Intervals of the numbers of a name."""
    return {
        k: (p["ci95"][0], p["ci95"][1])
        for e in o.said["effects"]
        if o.verdict == "named" and e["name"] == name
        for k, p in e["parameters"].items()
        if p.get("ci95") and None not in p["ci95"]
    }


def _first(o: Outcome) -> bool:
    """The first of the names that count is the hidden one."""
    return [n for n in o.named if n not in o.excused][:1] == [*o.hidden]


def _quiet(o: Outcome) -> bool:
    """Nothing is said that counts."""
    return o.verdict == "nothing" or (o.verdict == "named" and {*o.named} <= o.excused)
