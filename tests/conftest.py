"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest
from hypothesis import settings
from places import DATA, lacking

# CI draws the same examples on each run; elsewhere new ones are looked for.
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("here", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "here")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the recorded flights; CI fails without."""
    lacking(DATA.is_dir(), f"no recorded flights: {DATA} does not exist; set UAVTWIN_DATA")
    return DATA
