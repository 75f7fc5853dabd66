"""Write sensitivity.md, what settings of `explain` decide; `--help` tells of the options.

    python docs/_generate/sensitivity.py --out DIR --page docs/results/sensitivity.md --jobs 2

With `--watch` 20 seconds of a core per case: which settings can matter in it. Without, another ten
for each change that can, about ninety a case. A run that was cut short goes on.
"""

import sys
from pathlib import Path

sys.path.insert(
    0, str(Path(__file__).parents[2])
)  # benchmarks are no part of the installed package

from benchmarks.sensitivity.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
