"""Look for inputs that fell a reader: `make fuzz MINUTES=10`.

Prints how many inputs of each kind came out how. One that fells a reader joins `corpus.jsonl`, as
a recipe; `test_fuzz.py` runs these from then on.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

from fuzzing.all_kinds import KINDS, kind
from fuzzing.engine import Child, Result, recipes

CORPUS = Path(__file__).with_name("corpus.jsonl")


def search(names: list[str], seconds: float, seed: int) -> list[Result]:
    """Results of as many recipes of each kind as the time allows, by turns."""
    streams = [recipes(name, kind(name), seed) for name in names]
    end = time.monotonic() + seconds
    found = []
    with Child() as child:
        while time.monotonic() < end:
            found += [child.run(next(stream)) for stream in streams]
    return found


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


def main() -> None:
    """From the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**32)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--show-silent", action="store_true", help="their recipes")
    given = parser.parse_args()
    print(f"seed {given.seed}")
    found = search(given.kinds, 60.0 * given.minutes, given.seed)
    print(summary(found))
    known = set(CORPUS.read_text().splitlines()) if CORPUS.exists() else set()
    for result in found:
        if given.show_silent and result.visible and result.outcome == "silent":
            print(f"silent: {result.recipe.line()}")
        if result.fault and result.recipe.line() not in known:
            known.add(result.recipe.line())
            print(f"{result.outcome}: {result.recipe.line()}\n{result.text}")
            with CORPUS.open("a") as file:
                file.write(result.recipe.line() + "\n")
    raise SystemExit(any(r.fault for r in found))


if __name__ == "__main__":
    main()
