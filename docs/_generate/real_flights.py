"""Write what `explain` says about recorded flights as a page: 22 rotations of some minutes each.

    python docs/_generate/real_flights.py --data ../shared/data \\
        --out docs/results/real_flights.md --jobs 2

All tables go into `real_flights.jsonl` beside the page, and `--stored` makes the page from it.
A run that was cut short goes on where it stopped; `--help` tells of the other options.
"""

import sys
from pathlib import Path

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.real_flights.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
