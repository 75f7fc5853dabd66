"""The child: recipes on stdin, what came of them on stdout, each under limits."""

import json
import os
import resource
import signal
import sys
import tempfile
import traceback
from functools import cache
from pathlib import Path

from twin.errors import TwinError

from .all_kinds import kind
from .engine import BYTES, SECONDS, Outcome, Recipe, Seen


@cache
def _bases(name: str) -> dict[str, bytes]:
    return kind(name).bases()


def _read(name: str, blob: bytes, folder: Path) -> Seen:
    this = kind(name)
    path = folder / this.file
    path.write_bytes(blob)
    return this.read(path)


@cache
def _sound(name: str, base: str, folder: Path) -> Seen:
    return _read(name, _bases(name)[base], folder)


def _outcome(recipe: Recipe, folder: Path) -> tuple[Outcome, str]:
    """What comes of a recipe."""
    this = kind(recipe.kind)
    sound = _sound(recipe.kind, recipe.base, folder)
    blob = _bases(recipe.kind)[recipe.base]
    for step in recipe.steps:
        blob = this.apply(blob, step)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGE_SIZE") + BYTES, hard))
    signal.setitimer(signal.ITIMER_PROF, SECONDS)  # nobody handles it: the process dies
    try:
        seen = _read(recipe.kind, blob, folder)
    except TwinError as error:
        return "refused", str(error)
    except Exception:  # the fault that is looked for, of any kind
        return "crash", traceback.format_exc()[-2000:]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    if seen.content == sound.content:
        return "same", ""
    more = seen.told - sound.told
    return ("told", "; ".join(sorted(more))[:500]) if more else ("silent", "")


def main() -> None:
    """Answer each line until there is none."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # a reader that prints must not answer
    with tempfile.TemporaryDirectory() as name:
        for line in sys.stdin:
            recipe = Recipe.parse(line)
            outcome, text = _outcome(recipe, Path(name))
            change, given = recipe.steps[-1]  # it may hide earlier ones
            visible = change in kind(recipe.kind).visible and not given.get("still", False)
            out.write(json.dumps({"outcome": outcome, "text": text, "visible": visible}) + "\n")
            out.flush()


if __name__ == "__main__":
    main()
