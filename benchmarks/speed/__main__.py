"""The speed figures, measured here and now.

    python -m benchmarks.speed [--json]
    python -m benchmarks.speed --scale [--minutes 5,10,30] [--rate 1000] [--json]

With `--scale` time and memory of check, gap and explain against length of flight.
"""

import argparse
import json
from dataclasses import asdict
from typing import Any

from uavtwin.cli.printing import print_table
from uavtwin.display import TextTable

from .scale import Scale, run_scale
from .speed import run_bench


def tables(found: Scale) -> list[TextTable]:
    """Runs, then slopes."""
    runs = [
        (t.verb, f"{t.minutes:g}", f"{t.seconds:.1f}", f"{t.processor_s:.1f}", f"{t.peak_mb:.0f}")
        for t in found.runs
    ]
    slopes = [(s.verb, f"{s.processor_s_per_min:.2f}", f"{s.mb_per_min:.1f}") for s in found.slopes]
    header = ("verb", "flight, min", "s", "processor, s", "memory, MB")
    per_minute = ("verb", "processor, s per min of flight", "memory, MB per min of flight")
    return [TextTable(header, tuple(runs)), TextTable(per_minute, tuple(slopes))]


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scale", action="store_true")
    parser.add_argument("--minutes", default="5,10,30", help="lengths of the flights of --scale")
    parser.add_argument("--rate", type=float, default=1000.0, help="their rows per second")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    content: Any
    if given.scale:
        scale = run_scale([float(text) for text in given.minutes.split(",")], given.rate)
        content, shown = asdict(scale), tables(scale)
    else:
        rows = run_bench()
        content = [asdict(r) for r in rows]
        cells = tuple((r.what, f"{r.value:.3g}", r.unit, r.goal) for r in rows)
        shown = [TextTable(("what", "value", "unit", "goal"), cells)]
    if given.json:
        print(json.dumps(content, indent=2))
        return
    for table in shown:
        print_table(table)


if __name__ == "__main__":
    main()
