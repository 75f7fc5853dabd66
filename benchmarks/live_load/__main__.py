"""What a live flight bears: `python -m benchmarks.live_load --out OUT --page FILE`.

Measures how old what viewers see is, the processor that several aircraft take in one process, and
the memory of a long flight; one JSON file each in OUT. What is there is not
measured again.
"""

import argparse
import json
import os
from collections.abc import Callable
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from twin.why.watch import WINDOW_S

from .ages import ages
from .page import page
from .runs import aircraft_at_once, growth

_SECONDS, _AGES_S = 25.0, WINDOW_S + 35.0
"""Length of a flight of several aircraft, s, made up; and of the ages, from when on alarms have as
much flight as they hold."""


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--page", type=Path, help="write the page of what is there, and no more")
    parser.add_argument("--minutes", type=float, default=120.0, help="of the long flight")
    parser.add_argument("--speed", type=float, default=4.0, help="of the long flight")
    parser.add_argument("--aircraft", type=int, nargs="*", default=[1, 3, 10], help="at once")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.page:
        rows = {p.stem: json.loads(p.read_text()) for p in sorted(given.out.glob("*.json"))}
        given.page.write_text(page(rows), "utf-8")
        return 0
    for alarms in (True, False):
        name = f"ages_{'alarms' if alarms else 'bare'}"
        _once(given.out, name, partial(ages, _AGES_S, alarms))
    for count in given.aircraft:
        for alarms in (True, False):
            name = f"many_{count:02d}_{'alarms' if alarms else 'bare'}"
            _once(given.out, name, partial(aircraft_at_once, count, _SECONDS, alarms))
    _once(given.out, "growth", partial(growth, 60.0 * given.minutes, given.speed))
    return 0


def _once(out: Path, name: str, measure: Callable[[], dict[str, Any]]) -> None:
    """Measure what is not there yet."""
    path = out / f"{name}.json"
    if path.exists():
        return
    beside = {"load_before": os.getloadavg()[0], "measured": date.today().isoformat()}
    path.write_text(json.dumps({**measure(), **beside}), "utf-8")
    print(name, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
