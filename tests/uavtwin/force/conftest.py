"""What tests of learned forces share."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from uavtwin.force.memory import Memory


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Memory]:
    """The journal of a training that has taken no step."""
    with closing(Memory(tmp_path / "steps.jsonl", "")) as opened:
        yield opened
