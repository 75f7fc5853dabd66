"""Where things are: the root of the checkout, what the tests share, the host written in C; and what
to do where something is missing."""

import os
from importlib.util import find_spec
from pathlib import Path

import pytest

RIGS = Path(__file__).resolve().parent
ROOT = RIGS.parents[1]
HOST_SOURCE = RIGS / "host.c"
"""Loads an FMU of FMI 2 or 3 without Python."""
DATA = Path(os.environ.get("UAVTWIN_DATA", ROOT.parent / "shared" / "data"))
"""The recorded flights: $UAVTWIN_DATA, else shared/data beside the checkout."""
IMPORT_PATH = os.pathsep.join(map(str, (RIGS, ROOT)))
"""`PYTHONPATH` of another process: this checkout and what its tests share."""


def needs(present: bool, reason: str) -> pytest.MarkDecorator:
    """Skip where something is missing, but never in CI: there the test runs and fails."""
    return pytest.mark.skipif(not present and not os.environ.get("CI"), reason=reason)


def lacking(present: bool, reason: str) -> None:
    """The same from within a test or a fixture."""
    if not present and os.environ.get("CI"):
        pytest.fail(reason)
    if not present:
        pytest.skip(reason)


def needs_package(name: str) -> pytest.MarkDecorator:
    """The same of a package, by the name that it is imported by."""
    return needs(find_spec(name) is not None, f"{name} is not installed")
