"""The command line: `uavtwin VERB ...`. Exit codes: 0 fine, 1 findings, 2 wrong use, 3 our error.

One file per verb, which converts texts to objects and calls the same functions as `import uavtwin`.
Results are printed on stdout, progress and warnings on stderr. Large modules are imported only by
the verb that needs them, when it runs.
"""

import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from twin.errors import TwinError
from twin.scratch import scratch_folder

from .calibrate import calibrate
from .check import check
from .convert import convert
from .demo import demo
from .evaluate import evaluate
from .explain import explain
from .export import export
from .fleet import fleet
from .gap import gap
from .live import live
from .options import Exit
from .printing import STDERR, STDOUT, print_error
from .replay import replay
from .serve import serve
from .show import show
from .simulate import simulate
from .sweep import sweep
from .train import train
from .vehicle import vehicle
from .verify import verify
from .why import why


def version() -> None:
    """Print the version."""
    _print_version(True)


def _print_version(wanted: bool) -> None:
    """Print the version and end, if requested."""
    import uavtwin

    if wanted:
        STDOUT.print(uavtwin.__version__)
        raise typer.Exit(Exit.FINE)


_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Read on import of numpy and scipy, which the verbs do. With several threads sums have another
order and rounding; one thread is as fast for matrices of this size."""
PANELS = {
    "Your flights": (check, why, gap, explain, convert),
    "Your aircraft": (vehicle, calibrate, show),
    "Simulate and export": (simulate, sweep, export, verify),
    "Fleet and live": (serve, fleet, live, replay),
    "Learn": (train, evaluate),
    "Try": (demo,),
}
"""The verbs in the order of the help, by the kind of input. A verb is a function in a file of its
name, or a Typer application of further verbs, and a name here."""
HIDDEN = (version,)
"""Verbs that the help does not list: the one of `--version`."""
FORMER: dict[str, tuple[str, ...] | str] = {
    "hil": ("live", "--hil"),
    "query": ("fleet",),
    "generate": "generate: is no verb any more. A mission flown by what was trained: uavtwin "
    "simulate MISSION --model FOLDER.",
    "bench": "bench: is no verb any more. In a checkout: python -m benchmarks.speed.",
}
"""Former names of verbs, supported for one release, and their replacements or an explanation."""
_OPTION = re.compile(r"--?[a-z][a-z-]*(=.*)?", re.DOTALL)
"""Pattern of an option, which excludes a comment of SQL."""

VERBS = tuple(
    verb
    for verb in (*chain.from_iterable(PANELS.values()), *HIDDEN)
    if not isinstance(verb, typer.Typer)
)
"""All verbs that are functions, for the reference."""

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Hybrid digital twin of a multirotor, as FMI co-simulation components.",
)
for _panel, _verbs in PANELS.items():
    for _verb in _verbs:
        if isinstance(_verb, typer.Typer):
            app.add_typer(_verb, name=_verb.info.name, rich_help_panel=_panel)
        else:
            app.command(rich_help_panel=_panel)(_verb)
for _hidden in HIDDEN:
    app.command(hidden=True)(_hidden)


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Options before the verb."""


def main() -> None:
    """Entry point: an error becomes one line and an exit code, 2 where the user can correct it."""
    os.environ.update(dict.fromkeys(_BLAS_THREADS, "1"))
    try:
        with _temporary_files():
            app(_spread(_renamed(_checked(sys.argv[1:]))))
    except KeyboardInterrupt:
        _end_interrupted()
    except Exception as error:
        # CasADi converts an interrupt to a SystemError.
        if isinstance(error, SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
            _end_interrupted()
        sys.exit(print_error(error, f"uavtwin {shlex.join(sys.argv[1:])}"))


@contextmanager
def _temporary_files() -> Iterator[None]:
    """All temporary files, also of compilers, in one folder; the next call deletes those of killed
    calls."""
    given, before = os.environ.get("TMPDIR"), tempfile.tempdir
    with scratch_folder(Path(tempfile.gettempdir())) as folder:
        tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
        try:
            yield
        finally:
            tempfile.tempdir = before
            del os.environ["TMPDIR"]
            if given is not None:
                os.environ["TMPDIR"] = given


def _end_interrupted() -> NoReturn:
    STDERR.print("interrupted")
    sys.exit(130)


def _checked(arguments: list[str]) -> list[str]:
    """The arguments, refused where a file is in the place of the verb."""
    first = arguments[0] if arguments else ""
    if Path(first).is_file() and first not in {c.__name__ for c in VERBS}:
        file = shlex.quote(first)
        raise TwinError(
            f"{first}: a file stands where a verb is needed. Why a flight went wrong: uavtwin why "
            f"{file}. What a file holds: uavtwin check {file}. All verbs: uavtwin --help."
        )
    return arguments


def _renamed(arguments: list[str]) -> list[str]:
    """The present form of a former verb.

    Raises:
        TwinError: The verb was removed.
    """
    now = FORMER.get(arguments[0]) if arguments else None
    if now is None:
        return arguments
    if isinstance(now, str):
        raise TwinError(now)
    first, *rest = arguments
    return [*now, *(_asked(rest) if first == "query" else rest)]


def _asked(arguments: list[str]) -> list[str]:
    """Arguments of `query FOLDER SELECT` for `fleet`: the second positional becomes `--sql`."""
    command = typer.main.get_command(app).commands["fleet"]  # type: ignore[attr-defined]
    valued = {o for p in command.params if not getattr(p, "is_flag", True) for o in p.opts}
    places = [
        i
        for i, argument in enumerate(arguments)
        if argument != "--"
        and not _OPTION.fullmatch(argument)
        and (i == 0 or arguments[i - 1] not in valued)
    ]
    folder, sql, *_ = *(arguments[i] for i in places), "", ""
    if len(places) > 1:
        place = places[1]
        return [f"--sql={sql}", *arguments[:place], *arguments[place + 1 :]]
    if folder and not {"--sql", "--help"} & {a.partition("=")[0] for a in arguments}:
        raise TwinError(f'query: asks nothing. Write: uavtwin fleet {folder} --sql "SELECT ...".')
    return arguments


def _spread(arguments: list[str]) -> list[str]:
    """`--holdout A B` as `--holdout A --holdout B`, also for `--reference`: all files up to the
    next option belong to it."""
    found: list[str] = []
    option = ""
    for argument in arguments:
        if argument.startswith("-"):
            option = argument
        elif option in ("--holdout", "--reference") and found[-1] != option:
            found.append(option)
        found.append(argument)
    return found
