"""`uavtwin bench`: the speed figures of the README."""

from .options import Json
from .printing import print_json, print_table, progress


def bench(as_json: Json = False) -> None:
    """Measure the speed figures of the README, here and now."""
    from ..bench.speed import run_bench
    from ..shown import TextTable

    with progress("measuring") as step:
        rows = run_bench(step)
    if as_json:
        print_json([row.as_json() for row in rows])
        return
    cells = ((r.what, "-" if r.value is None else f"{r.value:.3g}", r.unit, r.goal) for r in rows)
    print_table(TextTable(("what", "value", "unit", "goal"), tuple(cells)))
