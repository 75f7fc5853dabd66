"""Look for inputs that fell a reader: `make fuzz MINUTES=10`, `make fuzz COUNT=100000`.

Prints how many inputs of each kind came out how. One that fells a reader joins `corpus.jsonl`, as
a recipe; `test_fuzz.py` runs these from then on.
"""

import argparse
import contextlib
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from fuzzing.all_kinds import KINDS, kind
from fuzzing.engine import Child, Result, recipes

CORPUS = Path(__file__).with_name("corpus.jsonl")


def search(
    names: list[str],
    most: int,
    seconds: float,
    seed: int,
    bases: Sequence[str] = (),
    changes: Sequence[str] = (),
) -> Iterator[Result]:
    """Results of recipes, until there are as many or the time is over.

    With `changes`, recipes that end with another change are left out.

    Each kind is given as much time, so that of those that are read at once there are more.
    """
    streams = {name: recipes(name, kind(name), seed, bases) for name in names}
    spent = dict.fromkeys(names, 0.0)
    begun = now = time.monotonic()
    with Child() as child:
        for _ in range(most):
            if now - begun > seconds:
                break
            name = min(names, key=lambda n: spent[n])
            yield child.run(
                next(r for r in streams[name] if not changes or r.steps[-1][0] in changes)
            )
            spent[name] -= now - (now := time.monotonic())


def summary(found: list[Result]) -> str:
    """Outcomes by kind, and of the last changes that could be seen how many were silent."""
    lines = []
    for name in sorted({r.recipe.kind for r in found}):
        of_kind = [r for r in found if r.recipe.kind == name]
        each = Counter(r.outcome for r in of_kind)
        lines.append(f"{name}: {len(of_kind)} inputs, {dict(each)}")
        visible = [r for r in of_kind if r.visible and r.outcome != "same"]
        steps = Counter((r.recipe.steps[-1][0], r.outcome == "silent") for r in visible)
        lines += [
            f"  {step}: {steps[step, True]} silent of {steps[step, True] + steps[step, False]}"
            for step in sorted({s for s, _ in steps})
        ]
    return "\n".join(lines)


def _until_interrupted(results: Iterator[Result]) -> Iterator[Result]:
    """The results up to Ctrl-C: they are summed up all the same."""
    with contextlib.suppress(KeyboardInterrupt):
        yield from results


def main() -> None:
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, help="at most; 10 where no count is given")
    parser.add_argument("--count", type=int, help="inputs in all")
    parser.add_argument("--bases", nargs="+", default=[], help="change these sound files alone")
    parser.add_argument("--changes", nargs="+", default=[], help="recipes that end with these")
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--show-silent", action="store_true", help="their recipes")
    given = parser.parse_args()
    print(f"seed {given.seed}")
    minutes = given.minutes or (10.0 if given.count is None else math.inf)
    most = given.count or sys.maxsize
    known = set(CORPUS.read_text().splitlines()) if CORPUS.exists() else set()
    found: list[Result] = []
    seconds = 60.0 * minutes
    results = search(given.kinds, most, seconds, given.seed, given.bases, given.changes)
    for result in _until_interrupted(results):
        found.append(result)
        if len(found) % 1000 == 0:
            print(f"{len(found)} inputs", file=sys.stderr, flush=True)
        if given.show_silent and result.visible and result.outcome == "silent":
            print(f"silent: {result.recipe.line()}")
        if result.fault and result.recipe.line() not in known:
            known.add(result.recipe.line())
            print(f"{result.outcome}: {result.recipe.line()}\n{result.text}")
            with CORPUS.open("a") as file:
                file.write(result.recipe.line() + "\n")
    print(summary(found))
    raise SystemExit(any(r.fault for r in found))


if __name__ == "__main__":
    main()
