"""Where things are: the root of the checkout, what the tests share, the host written in C."""

import os
from pathlib import Path

RIGS = Path(__file__).resolve().parent
ROOT = RIGS.parents[1]
HOST_SOURCE = RIGS / "host.c"
"""Loads an FMU of FMI 2 or 3 without Python."""
IMPORT_PATH = os.pathsep.join(map(str, (RIGS, ROOT)))
"""`PYTHONPATH` of another process: this checkout and what its tests share."""
