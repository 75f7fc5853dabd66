"""`uavtwin bench`: the speed figures of the README."""

from rich.table import Table

from .options import Json
from .printing import STDOUT, print_json, progress


def bench(as_json: Json = False) -> None:
    """Measure the speed figures of the README, here and now."""
    from ..bench.speed import run_bench

    with progress("measuring") as step:
        rows = run_bench(step)
    if as_json:
        print_json([row.as_json() for row in rows])
        return
    table = Table("what", "value", "unit", "goal", box=None)
    for row in rows:
        value = "-" if row.value is None else f"{row.value:.3g}"
        table.add_row(row.what, value, row.unit, row.goal)
    STDOUT.print(table)
