"""How well a program named what was hidden.

    python -m benchmarks.hidden_effects.scoring.score DIR

    DIR/results/ID.json   what the program said about each case
    DIR/truth/ID.json     what was hidden
    DIR/results.score.json   the figures that are printed
    DIR/results.reliability.svg   whether its probabilities are what they say

Verdicts are those of `explain.json` (named, nothing, unnamed, cannot_tell, unusable), and "error"
for a case that failed; such a case counts as wrong.
"""

import argparse
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ..files import write_json
from ..halves import HALVES
from .chances import of_inclusion, reliability
from .life import life_rows
from .measures import after_over_floor, parameter_errors, share_closed
from .outcomes import Outcome, read_outcomes
from .rates import middle, rate, share
from .reliability import reliability_svg
from .table import table

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
    told = any(o.lives or o.said.get("inclusion") for o in everything)
    return life_rows(everything) if told else []


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
