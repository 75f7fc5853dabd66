"""`uavtwin bench`: the speed figures; time and memory against length of flight."""

from typing import TYPE_CHECKING, Annotated

import typer

from twin.errors import TwinError

from .options import Json, Prints
from .printing import print_json, print_table, progress

if TYPE_CHECKING:
    from ..bench.scale import Scale


def bench(
    scale: Annotated[
        bool,
        typer.Option(
            "--scale",
            help="Instead, time and memory of check, gap and explain against length of flight.",
        ),
    ] = False,
    minutes: Annotated[
        str, typer.Option(help="Lengths of these flights, with commas between.")
    ] = "5,10,30",
    rate: Annotated[float, typer.Option(help="Rows of these flights per second.")] = 1000.0,
    as_json: Annotated[
        Json,
        Prints(
            "uavtwin.bench.figure:Row",
            "uavtwin.bench.scale:Scale",
            about="A list of figures; with `--scale` time and memory against length of flight.",
        ),
    ] = False,
) -> None:
    """Measure the speed figures, here and now."""
    from ..display import TextTable

    if scale:
        _scale(minutes, rate, as_json)
        return
    from ..bench.speed import run_bench

    with progress("measuring") as step:
        rows = run_bench(step)
    if as_json:
        print_json(rows)
        return
    cells = ((r.what, "-" if r.value is None else f"{r.value:.3g}", r.unit, r.goal) for r in rows)
    print_table(TextTable(("what", "value", "unit", "goal"), tuple(cells)))


def _scale(minutes: str, rate_hz: float, as_json: bool) -> None:
    """`bench --scale`."""
    from ..bench.scale import run_scale

    try:
        lengths = [float(text) for text in minutes.split(",")]
    except ValueError:
        raise TwinError(f"--minutes {minutes}: write numbers, e.g. 5,10,30.") from None
    with progress("measuring") as step:
        found = run_scale(lengths, rate_hz, progress=step)
    if as_json:
        print_json(found)
        return
    _print_scale(found)


def _print_scale(found: "Scale") -> None:
    """Runs, then slopes."""
    from ..display import TextTable

    runs = [
        (t.verb, f"{t.minutes:g}", f"{t.seconds:.1f}", f"{t.processor_s:.1f}", f"{t.peak_mb:.0f}")
        for t in found.runs
    ]
    header = ("verb", "flight, min", "s", "processor, s", "memory, MB")
    print_table(TextTable(header, tuple(runs)))
    slopes = [(s.verb, f"{s.processor_s_per_min:.2f}", f"{s.mb_per_min:.1f}") for s in found.slopes]
    if slopes:
        header3 = ("verb", "processor, s per min of flight", "memory, MB per min of flight")
        print_table(TextTable(header3, tuple(slopes)))
