"""What settings of `explain` decide: `python -m benchmarks.sensitivity --subset 4 --out DIR`.

    DIR/flights, DIR/truth             as of the benchmark of hidden effects
    DIR/answers/SETTING.WAY/ID.json    what is said with one setting changed
    DIR/answers/default/ID.json        what is said with none, and which changes may matter

A case is first run once with all settings watched (`watch`); a change that cannot matter in it has
the same answer and is not asked for. Answers of this state of `twin/` are used again, so a run that
was cut short goes on.
"""

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects import generate
from benchmarks.hidden_effects.files import write_json
from benchmarks.hidden_effects.measures import Outcome, read_outcomes
from benchmarks.hidden_effects.run import Question, Worker, answer, ask, explain_case, twin_state
from twin.explain.setting_group import Value
from twin.explain.settings import DEFAULT

from .changes import Change, change
from .page import page
from .variants import Variant, variants
from .watch import Noted, watch_case

USUAL = "default"
SMALL_SUBSET = 4
Asked = tuple[Path, Mapping[str, Value]]
"""Folder of a case, and the settings that are changed, by name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; exit code 1 when a case failed, 2 when it is used wrongly."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sensitivity", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--page", type=Path, help="Markdown file to write; default: stdout")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--only", nargs="+", default=(), metavar="NAME", help="settings that begin so"
    )
    parser.add_argument(
        "--watch", action="store_true", help="find out which changes may matter, ask for no more"
    )
    generate.add_options(parser)
    parser.set_defaults(subset=SMALL_SUBSET)
    options = parser.parse_args(given)
    chosen = list(variants(options.only))
    for name in options.only:
        if not any(v.setting.name.startswith(name) for v in chosen):
            parser.error(f"no setting begins with {name!r}; docs/reference/settings.md lists them")
    wanted = generate.chosen(options)
    generate.generate(options.out, wanted, options.jobs)
    ids = {case.id for case in wanted}
    answer_all(options.out, ids, () if options.watch else chosen, options.jobs)
    usual, changes = compare(options.out, ids, () if options.watch else chosen)
    command = f"{parser.prog} {shlex.join(_public(given))}"
    every, watched = len(list(DEFAULT.every())), noted_in(options.out, ids)
    text = page(command, every, usual, changes, twin_state(), watched)
    if options.page is None:
        print(text, end="")
    else:
        options.page.write_text(text, "utf-8")
    failed = any(o.verdict == "error" for o in usual) or any(c.errors for c in changes)
    return 1 if failed else 0


def ask_with(query: Asked) -> dict[str, Any]:
    """What is said about a case with some settings changed; an exception becomes a verdict."""
    folder, changed = query
    return answer(folder, partial(explain_case, changed=changed) if changed else watch_case)


def _worker() -> Worker:
    return Worker(ask_with)


def answer_all(
    out: Path,
    ids: Collection[str],
    chosen: Iterable[Variant],
    jobs: int,
    worker: Callable[[], Worker] = _worker,
) -> None:
    """Ask for what is not answered yet, the default settings first.

    Args:
        out: Folder with the flights.
        ids: Of the cases.
        chosen: What to change.
        jobs: Processes.
        worker: Makes one; it is called with `Asked`.
    """
    state, chosen = twin_state(), [*chosen]
    _ask(out, ids, [(USUAL, {})], state, jobs, worker)
    for i in ids:
        usual = _usual(out, i)
        for variant in chosen if "may" in usual else ():
            if variant.name not in usual["may"]:
                write_json(out / "answers" / variant.name / f"{i}.json", usual)
    _ask(out, ids, [(v.name, {v.setting.name: v.value}) for v in chosen], state, jobs, worker)
    if twin_state() != state:
        print("twin/ has changed meanwhile: run it again", file=sys.stderr)


def _ask(
    out: Path,
    ids: Collection[str],
    changes: Iterable[tuple[str, Mapping[str, Value]]],
    state: str,
    jobs: int,
    worker: Callable[[], Worker],
) -> None:
    """Ask for what is not answered yet, case by case."""
    every = [(i, *change) for i, change in product(sorted(ids), changes)]
    files = [out / "answers" / name / f"{i}.json" for i, name, _ in every]
    questions = [
        Question(f"{name} {i}", (out / "flights" / i, changed), file, {"case": i, "twin": state})
        for (i, name, changed), file in zip(every, files, strict=True)
        if not _is_answered(file, state)
    ]
    print(f"{len(every)} answers, {len(every) - len(questions)} known", file=sys.stderr)
    ask(questions, jobs, worker)


def compare(
    out: Path, ids: Collection[str], chosen: Iterable[Variant]
) -> tuple[list[Outcome], list[Change]]:
    """Answers with the default settings, and what each variant changes."""
    usual, _ = read_outcomes(out / "answers" / USUAL, out / "truth", ids)
    changes = []
    for variant in chosen:
        now, _ = read_outcomes(out / "answers" / variant.name, out / "truth", ids)
        changes.append(change(variant, usual, now))
    return usual, changes


def noted_in(out: Path, ids: Collection[str]) -> list[Noted]:
    """What was noted of the settings in each case that was watched."""
    every = [_usual(out, i) for i in sorted(ids)]
    return [Noted({*a["consulted"]}, {*a["may"]}) for a in every if "may" in a]


def _usual(out: Path, case: str) -> dict[str, Any]:
    """Answer with the default settings."""
    said: dict[str, Any] = json.loads((out / "answers" / USUAL / f"{case}.json").read_text("utf-8"))
    return said


def _is_answered(file: Path, state: str) -> bool:
    """Whether an answer of this state of `twin/` is there, and is one."""
    if not file.is_file():
        return False
    said = json.loads(file.read_text("utf-8"))
    return bool(said["twin"] == state and said["verdict"] != "error")


def _public(given: Sequence[str]) -> list[str]:
    """Arguments as a reader would type them: folders are his own."""
    shown, own = [], {"--out": "DIR", "--page": "docs/results/sensitivity.md"}
    for before, text in zip(["", *given], given, strict=False):
        shown.append(own.get(before, text))
    return shown


if __name__ == "__main__":
    raise SystemExit(main())
