"""The folder of a learned force: written, read back, refused where it is damaged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from learning.force.forecast import NO_OBSERVER, Observer
from learning.force.model import (
    FILE,
    ForceModel,
    LawScore,
    MissionCheck,
    Output,
    Rival,
    TrainingFlight,
    load_force,
    save_force,
)
from twin.errors import ModelError
from twin.logs import Flight
from twin.physics.residual_force import FEATURES, INPUTS, ForceLaw


def _law(n: int) -> ForceLaw:
    rng = np.random.default_rng(n)
    d = len(INPUTS)
    return ForceLaw(
        linear=rng.normal(size=(6, len(FEATURES))),
        centre=rng.normal(size=d),
        scale=np.ones(d),
        whitening=np.eye(d),
        reach=1.5,
        most=np.ones(6),
        units=np.eye(6),
    )


MODEL = ForceModel(
    law=_law(0),
    rivals={
        name: Rival(_law(n), (NO_OBSERVER,) * 6) for name, n in (("constant", 3), ("linear", 0))
    },
    outputs=(
        Output(
            "linear",
            Observer(0.2, 1.0),
            (LawScore("constant", -3.0), LawScore("linear", 12.0, 0.9, 1.01)),
        ),
        *(Output("none", NO_OBSERVER) for _ in range(5)),
    ),
    closed_loop=MissionCheck(12, 1, ("moment y linear",)),
    taken=0.1,
    flights=(TrainingFlight("one", "00"),),
    vehicle="x",
    vehicle_sha256="11",
    seed=3,
)


def _same(a: ForceLaw, b: ForceLaw) -> bool:
    there = b.arrays()
    return all(np.array_equal(v, there[k]) for k, v in a.arrays().items())


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    save_force(MODEL, tmp_path)
    found = load_force(tmp_path)
    assert _same(found.law, MODEL.law)
    assert all(_same(found.rivals[k].law, MODEL.rivals[k].law) for k in MODEL.rivals)
    assert all(found.rivals[k].observers == MODEL.rivals[k].observers for k in MODEL.rivals)
    assert replace(found, law=MODEL.law, rivals=MODEL.rivals) == MODEL


def test_the_same_model_gives_the_same_bytes(tmp_path: Path) -> None:
    save_force(MODEL, tmp_path)
    first = (tmp_path / FILE).read_bytes()
    save_force(load_force(tmp_path), tmp_path)
    assert (tmp_path / FILE).read_bytes() == first


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: c.update(format=99),
        lambda c: c["outputs"].pop("moment_z"),
        lambda c: c["law"].pop("reach"),
        lambda c: c["law"]["linear"].update(shape=[5, 5]),
        lambda c: c["law"]["scale"]["values"].__setitem__(0, -1.0),
        lambda c: c["outputs"]["force_x"]["observer"].update(lag="fast"),
        lambda c: c.update(inputs=["airspeed"]),
    ],
)
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, spoil: object) -> None:
    save_force(MODEL, tmp_path)
    content = json.loads((tmp_path / FILE).read_text("utf-8"))
    spoil(content)  # type: ignore[operator]
    (tmp_path / FILE).write_text(json.dumps(content), "utf-8")
    with pytest.raises(ModelError, match=rf"{FILE}.*Train the model again"):
        load_force(tmp_path)


def test_a_folder_without_one_says_who_writes_it(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="uavtwin train --protocol force"):
        load_force(tmp_path)


def test_a_flight_is_known_whatever_it_is_called() -> None:
    table = pd.DataFrame({"time": [0.0, 0.1], "pos_x": [1.0, np.nan], "phase": ["hover", ""]})
    flight = Flight("one", table)
    same = Flight("two", table[["phase", "pos_x", "time"]])
    other = Flight("one", table.assign(pos_x=[1.0, 2.0]))
    assert flight.fingerprint == same.fingerprint != other.fingerprint
