"""How well a program named what was hidden: `python -m benchmarks.hidden_effects.score RESULTS`.

    RESULTS/ID/explain.json   what the program said about each case
    --truth DIR/truth         what was hidden
    --out FILE                the figures as JSON

Verdicts are those of `explain.json` (named, nothing, unnamed, cannot_tell, unusable).
"""

import argparse
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from .measures import closed_gaps, over_floor, parameter_errors


@dataclass(frozen=True)
class Outcome:
    """One case: the truth and what was said about it."""

    truth: dict[str, Any]
    said: dict[str, Any]

    @property
    def hidden(self) -> set[str]:
        """Names of what was hidden."""
        return {e["name"] for e in self.truth["effects"]}

    @property
    def verdict(self) -> str:
        """What the program decided."""
        return str(self.said["verdict"])

    @property
    def named(self) -> list[str]:
        """Effects that the program added, the surest first; none unless the verdict is "named"."""
        if self.verdict != "named":
            return []
        effects = sorted(self.said["effects"], key=lambda e: -e["probability"])
        return [str(e["name"]) for e in effects]

    @property
    def right(self) -> bool:
        """The first name of a single effect, both of a pair, or the right other verdict."""
        match self.truth["kind"]:
            case "nothing":
                return self.verdict == "nothing"
            case "outside":
                return self.verdict == "unnamed"
            case "pair":
                return self.hidden <= set(self.named)
            case _:
                return self.named[:1] == [*self.hidden]


def read_outcomes(results: Path, truth: Path) -> tuple[list[Outcome], list[str]]:
    """Every case with a result, and the identifiers of those without one."""
    outcomes, missing = [], []
    for file in sorted(truth.glob("*.json")):
        said = results / file.stem / "explain.json"
        if said.is_file():
            outcomes.append(Outcome(json.loads(file.read_text()), json.loads(said.read_text())))
        else:
            missing.append(file.stem)
    return outcomes, missing


def score(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """All figures; a rate is null where no case counts for it."""
    kinds = {
        kind: [o for o in outcomes if o.truth["kind"] == kind]
        for kind in ("single", "pair", "nothing", "outside")
    }
    quiet, outside = kinds["nothing"], kinds["outside"]
    with_effects = kinds["single"] + kinds["pair"]
    return {
        "cases": len(outcomes),
        "right": {kind: _rate(found, lambda o: o.right) for kind, found in kinds.items()},
        "right_single": {
            by: _grouped(kinds["single"], by) for by in ("magnitude", "noise", "plant")
        },
        "false_alarms": _rate(quiet, lambda o: o.verdict in ("named", "unnamed")),
        "cannot_tell": _rate(outcomes, lambda o: o.verdict == "cannot_tell"),
        "cannot_tell_holds_truth": _rate(
            [o for o in with_effects if o.verdict == "cannot_tell"], _among_rivals
        ),
        "unusable": _rate(outcomes, lambda o: o.verdict == "unusable"),
        "outside_called_a_library_effect": _rate(outside, lambda o: o.verdict == "named"),
        "outside_share_explained": _median(
            sum(u["share"] for u in o.said.get("unnamed", []))
            for o in outside
            if o.verdict == "unnamed"
        ),
        "effects": _per_effect(outcomes),
        "parameters": _parameters(with_effects),
        "gap": {
            "share_closed": _median(g for o in with_effects for g in closed_gaps(o.said)),
            "after_over_floor": _median(g for o in with_effects for g in over_floor(o.said)),
        },
    }


def table(figures: dict[str, Any]) -> str:
    """The figures as text."""
    lines = [f"{figures['cases']} cases", ""]
    rows: list[tuple[str, Any]] = [
        ("right name first, single effect", figures["right"]["single"]),
        *(
            (f"  {by} {value}", rate)
            for by, rates in figures["right_single"].items()
            for value, rate in rates.items()
        ),
        ("both names, pairs", figures["right"]["pair"]),
        ("nothing, when nothing is hidden", figures["right"]["nothing"]),
        ("false alarms on quiet flights", figures["false_alarms"]),
        ("cannot tell", figures["cannot_tell"]),
        ("  with the truth among the rivals", figures["cannot_tell_holds_truth"]),
        ("unusable", figures["unusable"]),
        ("outside the library: unnamed", figures["right"]["outside"]),
        ("outside the library: wrongly named", figures["outside_called_a_library_effect"]),
        ("outside the library: share explained", figures["outside_share_explained"]),
        *((f"parameters: {k}", v) for k, v in figures["parameters"].items()),
        ("gap closed, share (median)", figures["gap"]["share_closed"]),
        ("gap after over noise floor (median)", figures["gap"]["after_over_floor"]),
    ]
    lines += [f"{what:<42} {_shown(value):>8}" for what, value in rows]
    lines += ["", f"{'effect':<26} {'n':>5} {'recall':>8} {'precision':>10}  taken for"]
    lines += [
        f"{name:<26} {e['n']:>5} {_shown(e['recall']):>8} {_shown(e['precision']):>10}  "
        + ", ".join(f"{k} {n}" for k, n in e["taken_for"].items())
        for name, e in figures["effects"].items()
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when results are missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    outcomes, missing = read_outcomes(options.results, options.truth)
    figures = score(outcomes)
    figures["missing"] = missing
    print(table(figures))
    if missing:
        print(f"\n{len(missing)} cases have no result, {missing[0]} first")
    if options.out:
        options.out.write_text(json.dumps(figures, indent=1) + "\n", "utf-8")
    return 1 if missing else 0


def _per_effect(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    names = sorted({n for o in outcomes for n in (*o.hidden, *o.named)})
    result = {}
    for name in names:
        there = [o for o in outcomes if name in o.hidden]
        said = [o for o in outcomes if name in o.named]
        taken: dict[str, int] = {}
        for o in there:
            if name not in o.named:
                for other in o.named or [o.verdict]:
                    if other not in o.hidden:
                        taken[other] = taken.get(other, 0) + 1
        result[name] = {
            "n": len(there),
            "recall": _share(len([o for o in there if name in o.named]), len(there)),
            "precision": _share(len([o for o in said if name in o.hidden]), len(said)),
            "taken_for": dict(sorted(taken.items(), key=lambda item: (-item[1], item[0]))),
        }
    return result


def _parameters(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Errors and coverage where the right effect was named and the name of a number matches."""
    errors = [e for o in outcomes for e in parameter_errors(o.truth, o.said, o.named)]
    exact = [e for e in errors if e.exact]
    return {
        "compared": len(errors),
        "median error": _median(e.relative for e in errors),
        "median error, same law": _median(e.relative for e in exact),
        "coverage": _rate([e for e in errors if e.covered is not None], lambda e: bool(e.covered)),
        "coverage, same law": _rate(
            [e for e in exact if e.covered is not None], lambda e: bool(e.covered)
        ),
    }


def _among_rivals(o: Outcome) -> bool:
    candidates = {e["name"] for e in o.said["effects"]} | {
        r["name"] for e in o.said["effects"] for r in e.get("rivals", [])
    }
    return o.hidden <= candidates


def _grouped(outcomes: Sequence[Outcome], by: str) -> dict[str, float | None]:
    values = sorted({str(o.truth[by]) for o in outcomes})
    return {
        v: _rate([o for o in outcomes if str(o.truth[by]) == v], lambda o: o.right) for v in values
    }


def _rate(items: Sequence[Any], good: Callable[[Any], bool]) -> float | None:
    return _share(sum(map(good, items)), len(items))


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _median(values: Iterable[float]) -> float | None:
    finite = [v for v in values if math.isfinite(v)]
    return median(finite) if finite else None


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3f}"


if __name__ == "__main__":
    raise SystemExit(main())
