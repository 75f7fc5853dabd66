"""Write what learned forces are worth as a page: 16 rotations of some minutes each.

    python docs/_generate/learned_force.py --data ../shared/data --jobs 2

A run that was cut short goes on where it stopped; `--help` tells of the other options.
"""

import sys
from pathlib import Path

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.learned_force.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
