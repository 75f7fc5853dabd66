"""A search that knows few effects: all of them take many times as long."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest

from twin.effects import EFFECTS
from twin.explain import calibration, holdout
from twin.explain.inference import selection


@contextmanager
def library(names: Sequence[str]) -> Iterator[None]:
    """A search, what it is held against and a calibration know these effects alone."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (calibration, holdout, selection):
            patch.setattr(module, "candidates", lambda *_: [EFFECTS[e] for e in names])
        yield
