"""How well a program named what was hidden.

    python -m benchmarks.hidden_effects.score DIR

    DIR/results/ID.json   what the program said about each case
    DIR/truth/ID.json     what was hidden
    DIR/results.score.json   the figures that are printed
    DIR/results.reliability.svg   whether its probabilities are what they say

Verdicts are those of `explain.json` (named, nothing, unnamed, cannot_tell, unusable), and "error"
for a case that failed; such a case counts as wrong.
"""

import argparse
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from .cases import HALVES
from .files import write_json
from .measures import (
    FAR,
    Outcome,
    ParameterError,
    after_over_fit_mean,
    after_over_floor,
    brier,
    calibration_error,
    class_said,
    classes_said,
    middle,
    of_inclusion,
    of_names,
    parameter_errors,
    rate,
    read_outcomes,
    reliability,
    reliability_svg,
    rotor_of,
    rotor_said,
    share,
    share_closed,
)

_KINDS = {"single": "single", "pair": "pair", "nothing": "quiet", "outside": "outside"}


def table(figures: dict[str, Any]) -> str:
    """The figures as text, 95 % intervals in brackets."""
    lines = [f"{figures['cases']} cases", ""]
    lines.append(f"{'':<50} {'value':>7} {'95 %':>16} {'n':>6}  goal")
    lines += [
        f"{row['what']:<50} {_value(row):>7} {_interval(row):>16} {row['n']:>6}  "
        f"{row.get('goal', '')}".rstrip()
        for row in (*figures["goals"], *figures["more"])
    ]
    lines += _life_table(figures)
    for by, groups in figures["by"].items():
        lines += ["", f"{'right, by ' + by:<18}" + "".join(f"{k:>16}" for k in _KINDS.values())]
        lines[-1] += f"{'cannot tell':>16}"
        lines += [
            f"  {value:<16}"
            + "".join(f"{_table_of(group[k]):>16}" for k in (*_KINDS, "cannot_tell"))
            for value, group in groups.items()
        ]
    lines += ["", f"{'effect':<24} {'n':>4} {'recall':>16} {'precision':>16} {'cannot tell':>16}"]
    lines += [
        f"{name:<24} {e['n']:>4} "
        + " ".join(f"{_table_of(e[k]):>16}" for k in ("recall", "precision", "cannot_tell"))
        for name, e in figures["effects"].items()
    ]
    lines += ["", f"{'number':<42} {'n':>4} {'error':>8} {'covered':>10}  law"]
    lines += [
        f"{name:<42} {p['error']['n']:>4} {_value(p['error']):>8} {_table_of(p['coverage']):>10}  "
        + ("same" if p["same_law"] else "alike about hover")
        for name, p in figures["parameters"].items()
    ]
    lines += ["", "wrong answers: hidden -> said"]
    lines += [f"{c['n']:>4}  {c['hidden']} -> {c['said']}" for c in figures["confusions"]]
    return "\n".join(lines + _remarks(figures))


def _life_table(figures: dict[str, Any]) -> list[str]:
    """Cases as in life, and both halves side by side where there are two."""
    lines = []
    if figures["life"]:
        lines += ["", f"{'as in life':<50} {'value':>7} {'95 %':>16} {'n':>6}"]
        lines += [
            f"{row['what']:<50} {_value(row):>7} {_interval(row):>16} {row['n']:>6}"
            for row in figures["life"]
        ]
    halves = {h: {r["what"]: r for r in rows} for h, rows in figures["halves"].items()}
    first, second = halves.values()
    shared = [w for w in first if w in second and first[w]["n"] and second[w]["n"]]
    if shared:
        lines += ["", f"{'by half':<50}" + "".join(f"{h:>20}" for h in halves)]
        lines += [
            f"{what:<50}" + "".join(f"{_counted(rows[what]):>20}" for rows in halves.values())
            for what in shared
        ]
    return lines


def _counted(row: dict[str, Any]) -> str:
    return f"{_value(row)} (n {row['n']})"


def _remarks(figures: dict[str, Any]) -> list[str]:
    """What a reader must know before the figures are believed."""
    lines = [f"{e['case']} failed: {e['error']}" for e in figures["errors"]]
    if figures["missing"]:
        lines.append(
            f"{len(figures['missing'])} cases have no result, {figures['missing'][0]} first"
        )
    if len(figures["twin"]) > 1:
        states = ", ".join(f"{n} by {state}" for state, n in figures["twin"].items())
        lines.append(f"results of different states of twin/: {states}; see --again changed")
    return ["", *lines] if lines else []


def _value(row: dict[str, Any]) -> str:
    value = row["value"]
    return "-" if value is None else f"{value:.3g}" if value >= 10 else f"{value:.3f}"


def _interval(row: dict[str, Any]) -> str:
    return "" if row["ci95"] is None else "[{:.3g}, {:.3g}]".format(*row["ci95"])


def _table_of(row: dict[str, Any]) -> str:
    """A share as good ones of all."""
    return f"{row['value']:.2f} ({row['good']}/{row['n']})" if row["n"] else "-"


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


_LEVELS = ("none", "low", "small", "medium", "high", "large")


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when results are missing or failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dir", type=Path)
    parser.add_argument("--results", default="results", help="name of the folder in DIR")
    parser.add_argument("--half", choices=HALVES, help="of plants and effects; default: both")
    options = parser.parse_args(arguments)
    return write_score(options.dir, options.results, half=options.half)


def write_score(
    out: Path,
    results: str = "results",
    ids: Collection[str] | None = None,
    half: str | None = None,
) -> int:
    """Print the table and write it as JSON beside the results; 1 when results are missing."""
    outcomes, missing = read_outcomes(out / results, out / "truth", ids)
    outcomes = [o for o in outcomes if half in (None, o.half)]
    figures = score(outcomes, missing)
    write_json(out / f"{results}.score.json", figures)
    print(table(figures))
    if figures["reliability"]:
        picture = reliability_svg(figures["reliability"])
        (out / f"{results}.reliability.svg").write_text(picture, "utf-8")
    return 1 if missing or figures["errors"] else 0


def score(everything: Sequence[Outcome], missing: Sequence[str] = ()) -> dict[str, Any]:
    """All figures; a value is null where no case counts for it.

    Cases that have what real aircraft have count for `life` and `halves` alone.
    """
    outcomes = [o for o in everything if not o.lives]
    return {
        "cases": len(everything),
        "missing": list(missing),
        "errors": [
            {"case": o.said.get("case"), "error": o.said.get("error")}
            for o in everything
            if o.verdict == "error"
        ],
        "twin": dict(Counter(str(o.said.get("twin")) for o in everything)),
        "goals": _goals(outcomes),
        "more": _more(outcomes),
        "by": {by: _by(outcomes, by) for by in ("magnitude", "noise", "plant")},
        "effects": _per_effect(outcomes),
        "parameters": _parameters(outcomes),
        "confusions": _confusions(outcomes),
        "life": _life(everything),
        "halves": _halves(everything),
        "reliability": _reliability(everything),
    }


def _life(everything: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Of cases as in life; none where there is no such case and no probability."""
    answered = any(o.lives or o.said.get("inclusion") for o in everything)
    return life_rows(everything) if answered else []


def _halves(everything: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Goals and life of the half on which things may be chosen, and of the other."""
    parts = {half: [o for o in everything if o.half == half] for half in HALVES}
    return {
        half: [*_goals([o for o in part if not o.lives]), *_life(part)]
        for half, part in parts.items()
    }


def _reliability(everything: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Bins of probabilities by half; empty where no program gave any."""
    forecasts = {h: of_inclusion([o for o in everything if o.half == h]) for h in HALVES}
    return {half: reliability(found) for half, found in forecasts.items() if found}


def _goals(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """What the issue sets goals for."""
    single = [o for o in _of(outcomes, "single") if o.truth["magnitude"] == "medium"]
    outside = _of(outcomes, "outside")
    named = [o for o in _hidden(outcomes) if o.verdict == "named"]
    errors = [e for o in single for e in parameter_errors(o.truth, o.said, o.named) if e.exact]
    rows: list[tuple[str, dict[str, Any], str]] = [
        ("single medium effect: right name first", rate(single, _is_right), ""),
        ("pairs: both named", rate(_of(outcomes, "pair"), _is_right), ""),
        ("quiet flights: nothing", rate(_of(outcomes, "nothing"), _is_right), ""),
        ("numbers inside their 95 % interval", rate(errors, lambda e: bool(e.covered)), "95 %"),
        ("median error of a number", middle(e.relative for e in errors), ""),
        (
            "gap with the effect added over noise floor, median",
            middle(after_over_floor(o) for o in named),
            "",
        ),
        (
            "outside the library, given another name",
            rate(outside, lambda o: bool(o.verdict == "named")),
            "< 5 %",
        ),
        (
            "seconds per case, median",
            middle(o.said["seconds"] for o in outcomes if "seconds" in o.said),
            "",
        ),
    ]
    return [{"what": what, "goal": goal, **value} for what, value, goal in rows]


def _more(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Other figures of the whole."""
    hidden = _hidden(outcomes)
    tied = [o for o in hidden if o.verdict == "cannot_tell"]
    outside = _of(outcomes, "outside")
    unnamed = [o for o in outside if o.verdict == "unnamed"]
    triples = _of(outcomes, "triple")
    rows = [
        ("triples: all three named", rate(triples, _is_right)),
        ("  of the effects hidden in them", share(*_found(triples))),
        ("single effect, all magnitudes", rate(_of(outcomes, "single"), _is_right)),
        (
            "quiet flights: false alarms",
            rate(
                _of(outcomes, "nothing"), lambda o: bool(o.verdict in ("named", "unnamed", "error"))
            ),
        ),
        ("cannot tell", rate(outcomes, lambda o: bool(o.verdict == "cannot_tell"))),
        ("  with the truth among the candidates", rate(tied, lambda o: bool(o.among_candidates))),
        ("unusable", rate(outcomes, lambda o: bool(o.verdict == "unusable"))),
        ("failed", rate(outcomes, lambda o: bool(o.verdict == "error"))),
        ("outside the library: unnamed", rate(outside, _is_right)),
        (
            "outside the library: share explained, median",
            middle(sum(u["share"] for u in o.said.get("unnamed", [])) for o in unnamed),
        ),
        ("share of the gap closed, median", middle(share_closed(o) for o in hidden)),
        (
            "processor seconds per case, median",
            middle(o.said["cpu_seconds"] for o in outcomes if "cpu_seconds" in o.said),
        ),
    ]
    return [{"what": what, **value} for what, value in rows]


def _by(outcomes: Sequence[Outcome], by: str) -> dict[str, dict[str, Any]]:
    """Right answers by kind, for each value of a property of the cases."""
    groups: dict[str, list[Outcome]] = {}
    for o in sorted(outcomes, key=lambda o: _place(str(o.truth[by]))):
        groups.setdefault(str(o.truth[by]), []).append(o)
    return {
        value: {
            **{k: rate(_of(group, k), _is_right) for k in ("single", "pair", "nothing", "outside")},
            "cannot_tell": rate(group, lambda o: bool(o.verdict == "cannot_tell")),
        }
        for value, group in groups.items()
    }


def _per_effect(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    """Every effect of the library that was hidden or named, alone and in pairs."""
    outside = {n for o in _of(outcomes, "outside") for n in o.hidden}
    names = sorted({n for o in outcomes for n in (*o.hidden, *o.named)} - outside)
    result = {}
    for name in names:
        there = [o for o in outcomes if name in o.hidden]
        said = [o for o in outcomes if name in o.named]
        both = len([o for o in there if name in o.named])
        result[name] = {
            "n": len(there),
            "recall": share(both, len(there)),
            "precision": share(both, len(said)),
            "cannot_tell": rate(there, lambda o: bool(o.verdict == "cannot_tell")),
        }
    return result


def _parameters(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    """Every number that could be compared: the effect rightly named, name and unit the same."""
    found: dict[str, list[Any]] = {}
    for o in _hidden(outcomes):
        for e in parameter_errors(o.truth, o.said, o.named):
            found.setdefault(e.name, []).append(e)
    return {
        name: {
            "same_law": errors[0].exact,
            "error": middle(e.relative for e in errors),
            "coverage": rate(errors, lambda e: bool(e.covered)),
        }
        for name, errors in sorted(found.items())
    }


def _confusions(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """What was said where it was wrong, the most frequent first."""
    found = Counter(
        ("+".join(sorted(o.hidden)) or "nothing", "+".join(o.named) or o.verdict)
        for o in outcomes
        if not o.right
    )
    ranked = sorted(found.items(), key=lambda item: (-item[1], item[0]))
    return [{"hidden": hidden, "said": said, "n": n} for (hidden, said), n in ranked]


def _of(outcomes: Sequence[Outcome], kind: str) -> list[Outcome]:
    return [o for o in outcomes if o.kind == kind]


def _hidden(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Those with effects of the library."""
    return [o for kind in ("single", "pair", "triple") for o in _of(outcomes, kind)]


def _found(outcomes: Sequence[Outcome]) -> tuple[int, int]:
    """Hidden effects that were named, and hidden effects."""
    return sum(len(o.hidden & {*o.named}) for o in outcomes), sum(len(o.hidden) for o in outcomes)


def _place(value: str) -> tuple[int, str]:
    """Levels by size, names by the alphabet."""
    return (_LEVELS.index(value) if value in _LEVELS else len(_LEVELS)), value


def _is_right(o: Outcome) -> bool:
    return o.right


if __name__ == "__main__":
    raise SystemExit(main())
