"""Each family of compensators keeps its word under each preset and protocol."""

import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning_rigs.residual_rig import made_up

from learning.data.flights import ResidualFlight
from learning.model.compensator import Compensator
from learning.model.family import Family, TrainedModel, TrainingTask
from learning.model.folder import MODEL, WEIGHTS, load, save
from learning.model.registry import (
    FAMILIES,
    check_preset,
    family_named,
    preset_named,
)
from learning.preset import PRESETS, Protocol
from learning.training.train import Svq, fit_model
from twin.errors import ModelError

HORIZONS = {"reconstruct": 0, "track": 2, "free": 0}
FLIGHTS = [made_up(0, every=3), made_up(1, every=3)]
AWAY = made_up(2, every=3)
AnyFamily = Family[Any, Any]
FAMILY_LIST = [family_named(name) for name in FAMILIES]
LARGEST_WIDTH = 64
"""Presets with more units than that are left to the benchmarks."""


def quick(preset: Any) -> Any:
    """The preset, trained for one epoch where it has some."""
    epochs = {"epochs": 1} if any(f.name == "epochs" for f in fields(preset)) else {}
    return replace(preset, **epochs)


def cases() -> list[Any]:
    """Every preset that is quick enough under each of its protocols."""
    found = []
    for family in FAMILY_LIST:
        for preset in map(quick, family.presets.values()):
            if max(getattr(preset, "encoder_units", ()), default=0) <= LARGEST_WIDTH:
                for protocol in family.protocols(preset):
                    name = f"{family.name}-{preset.name}-{protocol}"
                    found.append(pytest.param(family, preset, protocol, id=name))
    return found


def trained(family: AnyFamily, preset: Any, protocol: Protocol, folder: Path) -> TrainedModel:
    task = TrainingTask(protocol, HORIZONS[protocol], 3, "v", "0f")
    return fit_model(FLIGHTS, family, preset, task, folder)


Trained = Callable[[AnyFamily, Any, Protocol], tuple[TrainedModel, Path]]


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A model and its folder, neither to be changed."""

    @cache
    def model(family: AnyFamily, preset: Any, protocol: Protocol) -> tuple[TrainedModel, Path]:
        folder = tmp_path_factory.mktemp(f"{family.name}-{protocol}")
        return trained(family, preset, protocol, folder), folder

    return model


# -- each keeps its word --------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("family", "preset", "protocol"), cases())
def test_a_model_is_kept_as_it_is(
    family: AnyFamily, preset: Any, protocol: Protocol, once: Trained, tmp_path: Path
) -> None:
    """Written and read: same bytes, same correction to the last bit; same seed, same bytes."""
    model, folder = once(family, preset, protocol)
    again = load(folder)
    assert again.family == model.family and again.info == model.info
    assert again.info.protocol == protocol and again.info.horizon == HORIZONS[protocol]
    assert (again.info.vehicle, again.info.seed, again.info.rate_hz) == ("v", 3, 100.0)
    assert [f["name"] for f in again.info.flights] == ["made_up_0", "made_up_1"]
    for name in ("correction", "spread", "anomaly", "inside"):
        one, other = (getattr(m.run(AWAY), name) for m in (model, again))
        np.testing.assert_array_equal(one, other, err_msg=name)
    save(again, tmp_path / "copy")
    trained(family, preset, protocol, tmp_path / "two")
    for name in (MODEL, WEIGHTS):
        written = (folder / name).read_bytes()
        assert written == (tmp_path / "copy" / name).read_bytes(), name
        assert written == (tmp_path / "two" / name).read_bytes(), name


@pytest.mark.slow
@pytest.mark.parametrize(("family", "preset", "protocol"), cases())
def test_a_model_is_finite_and_sees_what_it_may(
    family: AnyFamily, preset: Any, protocol: Protocol, once: Trained
) -> None:
    """A measurement changes nothing before its age is that of the horizon; in `free` nothing."""
    model, _ = once(family, preset, protocol)
    row_of_change, (a, b) = 40, AWAY.spans[0]
    residual, fresh = AWAY.residual.copy(), AWAY.fresh.copy()
    residual[row_of_change] += 3 * np.std(AWAY.residual, axis=0)
    fresh[row_of_change] = True
    before, after = (
        model.run(replace(AWAY, residual=r, fresh=fresh)) for r in (AWAY.residual, residual)
    )
    for found in (before, after):
        inside = np.zeros(len(AWAY.t_s), dtype=np.bool_)
        for start, end in AWAY.spans:
            inside[start:end] = True
        assert found.correction.shape == AWAY.residual.shape
        assert np.isfinite(found.correction[inside]).all()
        assert np.isfinite(found.spread).all() and (found.spread >= 0).all()
    change = np.any(before.correction[a:b] != after.correction[a:b], axis=1)
    first = int(np.argmax(change)) if change.any() else b
    earliest = b if protocol == "free" else row_of_change + HORIZONS[protocol]
    assert first >= earliest, f"the measurement of row {row_of_change} shows in row {first}"


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILY_LIST, ids=list(FAMILIES))
def test_other_flights_are_refused(family: AnyFamily, once: Trained) -> None:
    preset = quick(next(iter(family.presets.values())))
    model, _ = once(family, preset, family.protocols(preset)[0])
    with pytest.raises(ModelError, match=r"50 Hz.*100 Hz"):
        model.run(replace(AWAY, rate_hz=50.0))
    with pytest.raises(ModelError, match=r"4 motor commands.*with 2"):
        model.run(replace(AWAY, commands=np.zeros((len(AWAY.t_s), 4))))


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILY_LIST, ids=list(FAMILIES))
def test_what_is_exported_is_what_the_family_says(
    family: AnyFamily, once: Trained, tmp_path: Path
) -> None:
    preset = quick(family.presets[family.usual])
    model, _ = once(family, preset, family.protocols(preset)[0])
    written = family.export(model, tmp_path)
    assert ("model.onnx" in written) is family.onnx, f"{family.name!r} says onnx={family.onnx}"
    assert all((tmp_path / name).is_file() for name in written)


# -- the folder -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(once: Trained) -> Path:
    family, preset = preset_named("linear")
    return once(family, quick(preset), "track")[1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"family": "oracle"}, "no family 'oracle'; there are .*svq"),
        ({"protocol": "free", "horizon": 0}, "size mismatch"),
        ({"preset": {"name": "linear", "depth": 3}}, "depth"),
    ],
)
def test_a_folder_of_another_family_is_refused(
    folder: Path, tmp_path: Path, change: dict[str, object], said: str
) -> None:
    content = json.loads((folder / MODEL).read_text()) | change
    (tmp_path / WEIGHTS).write_bytes((folder / WEIGHTS).read_bytes())
    (tmp_path / MODEL).write_text(json.dumps(content))
    with pytest.raises(ModelError, match=f"{said}.*train the model again"):
        load(tmp_path)


# -- presets --------------------------------------------------------------------------------


def test_unknown_presets_and_protocols_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"no preset 'bset'; there are .*paper.*linear"):
        preset_named("bset")
    family, preset = preset_named("linear")
    with pytest.raises(ModelError, match="preset linear: not under protocol reconstruct, only un"):
        check_preset(family, preset, "reconstruct")
    with pytest.raises(ModelError, match="not under protocol reconstruct"):
        fit_model(FLIGHTS, family, preset, TrainingTask("reconstruct"), tmp_path)
    with pytest.raises(ModelError, match="protocol track: horizon 0"):
        fit_model(FLIGHTS, family, preset, TrainingTask("track"), tmp_path)
    with pytest.raises(ModelError, match="at least one flight"):
        fit_model([], family, preset, TrainingTask("free"), tmp_path)


# -- the members ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["track", "free"])
def test_the_linear_family_is_the_network_with_shut_gates(
    protocol: Protocol, once: Trained
) -> None:
    """What is left of it where the network is taken away."""
    family, preset = preset_named("linear")
    one, _ = once(family, quick(preset), protocol)
    other, _ = once(family_named("svq"), quick(PRESETS["best"]), protocol)
    assert isinstance(one, Compensator) and isinstance(other, Compensator)
    assert one.network is None and not [n for n in one.tensors() if n.startswith("network")]
    opened = other.gate.clone()
    alone = other.without_network() or other
    assert torch.equal(other.gate, opened)
    said, expected = one.run(AWAY), alone.run(AWAY)
    np.testing.assert_array_equal(said.inside, expected.inside)
    size = AWAY.residual.std(axis=0)
    np.testing.assert_allclose(said.correction / size, expected.correction / size, atol=1e-5)
    assert np.abs(said.correction / size).max() > 0.1
    assert np.isnan(said.anomaly).all() == (protocol == "free")


def test_a_network_that_says_nothing_is_not_kept(once: Trained) -> None:
    """After one epoch it adds nothing to the linear prediction of these flights."""
    model, folder = once(family_named("svq"), quick(PRESETS["best"]), "free")
    assert isinstance(model, Compensator) and not model.gate.any()
    assert model.network is None and model.family == "linear"
    assert (folder / WEIGHTS).stat().st_size < 50_000


def test_a_channel_that_is_shut_is_not_corrected(tmp_path: Path) -> None:
    model = trained(*preset_named("linear"), "free", tmp_path)
    assert isinstance(model, Compensator)
    before = model.run(AWAY)
    model.shut([0, 4])
    after, others = model.run(AWAY), [i for i in range(15) if i not in (0, 4)]
    assert before.correction[:, [0, 4]].any() and not after.correction[:, [0, 4]].any()
    np.testing.assert_array_equal(after.correction[:, others], before.correction[:, others])
    rms = model.scaling().rms[[0, 4]]
    np.testing.assert_allclose(after.spread[:, [0, 4]] / rms, 1.0, rtol=1e-6)


def test_the_spread_of_the_linear_family_is_that_of_what_is_left_today(once: Trained) -> None:
    """Of every sensor, though what flights left out have is more."""
    family, preset = preset_named("linear")
    model, _ = once(family, quick(preset), "track")
    flight: ResidualFlight = FLIGHTS[0]
    found = model.run(flight)
    rows = flight.fresh & found.inside[:, None]
    ratio = np.where(rows, (flight.residual - found.correction) / found.spread, np.nan)
    share = np.sqrt(np.nanmean(ratio**2, axis=0))
    assert 0.9 < np.median(share) < 1.1 and share.min() > 0.75 and share.max() < 1.25


def test_svq_has_the_presets_of_the_paper() -> None:
    assert Svq.presets is PRESETS
