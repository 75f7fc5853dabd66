"""The page on learned forces: who teaches whom, and figures that are known beforehand."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from benchmarks.learned_force.closed_loop import STILL
from benchmarks.learned_force.page import beyond_observer, page
from benchmarks.learned_force.rotations import FINER, GROUPS, RECORDED, Places, rotations
from uavtwin.force.evaluate import CLAIMED_S, EXPLAINED, SHIPPED, UNTRAINED, summary
from uavtwin.force.open_loop import QUANTITIES

PLACES = Places(Path("data"), Path("work"))


@pytest.mark.parametrize("group", GROUPS)
def test_no_flight_is_judged_that_taught(group: str) -> None:
    flown = []
    for rotation in rotations([group]):
        taught, own = rotation.files(PLACES)
        assert taught and own and not set(taught) & set(own)
        flown += own
    assert len(flown) == len(set(flown))


def test_every_recorded_flight_is_judged_once() -> None:
    every = rotations(RECORDED)
    assert len(every) == len({(r.group, r.name) for r in every}) == 10


def _case(group: str, off: dict[str, float]) -> dict[str, Any]:
    """A flight on which every cell of a twin is off by one number."""
    table = pd.DataFrame(
        [
            {
                "model": model,
                "flight": "one",
                "horizon_s": CLAIMED_S,
                "quantity": quantity,
                "axis": axis,
                "unit": unit,
                "rms": rms,
            }
            for model, rms in off.items()
            for quantity, unit in QUANTITIES
            for axis in "xyz"
        ]
    )
    said = {
        "inside": {"one": [1.0, 1.0, 0.97, 0.9, 0.8]},
        "windows": {"one": 40},
        "summary": summary(table).to_dict("records"),
        "cells": table.to_dict("records"),
    }
    flown = [
        {
            "mission": "tour",
            "law": law,
            "lost": False,
            "off_m": off,
            "alone_m": 0.5,
            "inside": 0.9,
        }
        for law in (SHIPPED, STILL)
        for off in (0.4, 0.5, 0.6)
    ]
    return {
        "group": group,
        "name": "one",
        "named": [],
        "claim": "force: x.",
        "evaluation": said,
        "closed_loop": flown,
    }


def test_figures_of_the_page() -> None:
    case = _case(FINER, {EXPLAINED: 2.0, UNTRAINED: 1.0, SHIPPED: 0.25})
    assert beyond_observer(case) == pytest.approx(0.75)
    text = page([case])
    assert "| 1 | 0.12 | 0.12 | 0.433 to 0.433 | 97 to 97 % | 90 % |" in text
    assert "is off, 75 % is gone" in text
    assert f"| {SHIPPED} | 3 | 0 | 1.000 | 1.200 | 1 |" in text
