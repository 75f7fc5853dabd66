"""The table of an evaluation: what is scored, how it is pooled, and what is refused."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from learning.data.channels import CHANNELS, GROUPS, PHASE_CODES
from learning.data.flights import ResidualFlight, held
from learning.evaluation import WHOLE, evaluate, pooled
from learning.model.family import Corrected, Model, TrainingTask
from twin.errors import ModelError

Array = np.ndarray
HOVER, TOUR = PHASE_CODES["hover"], PHASE_CODES["tour"]
FREE = TrainingTask("free")


def flight_of(seed: int, n: int = 400, offset: float = 5.0) -> ResidualFlight:
    """Half hover, half tour, which moves three times as much; magnetometer every 10 samples."""
    rng = np.random.default_rng(seed)
    fresh = np.ones((n, 15), dtype=np.bool_)
    fresh[:, GROUPS["mag"]] = (np.arange(n) % 10 == 0)[:, None]
    phase = np.repeat([HOVER, TOUR], n // 2).astype(np.intp)
    residual = offset + np.where(phase == TOUR, 3.0, 1.0)[:, None] * rng.standard_normal((n, 15))
    return ResidualFlight(
        name=f"flight {seed}",
        rate_hz=100.0,
        t_s=np.arange(n) / 100,
        virtual=rng.standard_normal((n, 15)),
        residual=held(np.where(fresh, residual, np.nan)),
        fresh=fresh,
        commands=rng.random((n, 4)),
        phase=phase,
        spans=((0, n),),
    )


@dataclass(frozen=True)
class Share:
    """Knows the residual and takes a share of it away; spread as given."""

    share: float
    spread: float = 1.0
    offset: float = 0.0

    def run(self, flight: ResidualFlight) -> Corrected:
        n = len(flight.t_s)
        correction = self.share * np.nan_to_num(flight.residual) + self.offset
        spread = np.full(correction.shape, self.spread)
        return Corrected(correction, spread, np.zeros(n), np.arange(n) % 4 > 0)


TRAIN, TEST = [flight_of(0), flight_of(1)], [flight_of(2), flight_of(3)]


def table_of(models: Mapping[str, Model] | Model | None, task: TrainingTask = FREE) -> pd.DataFrame:
    return evaluate(models, TRAIN, TEST, task)


def row(table: pd.DataFrame, **where: str) -> pd.Series:
    chosen = table
    for key, value in where.items():
        chosen = chosen[chosen[key] == value]
    assert len(chosen) == 1, where
    return chosen.iloc[0]


# -- rows -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_cell_has_a_row_and_only_fresh_samples_count() -> None:
    table = table_of(Share(0.5))
    keys = ["model", "flight", "phase", "channel"]
    assert len(table) == len(table.drop_duplicates(keys))
    models = {"none", "mean", "mean reading", "linear in inputs", "model"}
    assert set(table["model"]) == models
    assert len(table) == len(models) * 2 * 3 * 15
    assert set(table["n"][(table.group == "gyro") & (table.phase == WHOLE)]) == {400}
    assert set(table["n"][(table.group == "mag") & (table.phase == WHOLE)]) == {40}
    assert set(table["n"][(table.group == "mag") & (table.phase == "tour")]) == {20}
    assert set(table["unit"][table.channel == "mag_x"]) == {"T"}


@pytest.mark.slow
def test_numbers_of_a_row() -> None:
    table = table_of(Share(0.75, spread=0.5))
    r = row(table, model="model", flight="flight 2", phase="tour", channel="acc_y")
    c = CHANNELS.index("acc_y")
    residual = TEST[0].residual[200:, c]
    left = residual / 4
    assert r["mse"] == pytest.approx(np.mean(left**2))
    assert r["rmse"] == pytest.approx(np.sqrt(r["mse"]))
    assert r["mae"] == pytest.approx(np.mean(np.abs(left)))
    assert r["wasserstein"] == pytest.approx(
        np.mean(np.abs(np.sort(residual) - np.sort(0.75 * residual)))
    )
    assert r["removed"] == pytest.approx(0.75)
    assert r["removed_beyond_constant"] == pytest.approx(0.75)
    assert r["within_1"] == np.mean(np.abs(left) <= 0.5)
    assert r["within_2"] == np.mean(np.abs(left) <= 1.0)
    assert r["inside"] == 0.75


@pytest.mark.slow
def test_a_constant_is_subtracted_before_the_share_beyond_it() -> None:
    """Taking away the mean removes most of the rms, and nothing beyond a constant."""
    table = table_of(Share(0.0, offset=5.0))
    whole = table[(table.model == "model") & (table.phase == WHOLE) & (table.group != "mag")]
    assert (whole["removed"] > 0.5).all()
    assert np.allclose(whole["removed_beyond_constant"], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        TrainingTask("reconstruct"),
        TrainingTask("track", 1),
        TrainingTask("track", 50),
        TrainingTask("free"),
    ],
    ids=lambda t: f"{t.protocol}-{t.horizon}",
)
def test_baselines_of_every_task(task: TrainingTask) -> None:
    table = table_of(None, task)
    assert {"none", "mean"} < set(table["model"])
    assert set(table["protocol"]) == {task.protocol} and set(table["horizon"]) == {task.horizon}
    if task.protocol == "reconstruct":  # what the protocol is worth
        assert table.loc[table.model == "last", "rmse"].max() < 1e-12
    for name in ("rmse", "removed", "within_1"):
        assert table[name].notna().all()


@pytest.mark.slow
def test_same_input_same_table() -> None:
    pd.testing.assert_frame_equal(table_of(Share(0.5)), table_of(Share(0.5)))


# -- pooled ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_pooled_is_what_all_samples_together_give() -> None:
    table = table_of({"half": Share(0.5), "all": Share(1.0)})
    whole = pooled(table[table.phase == WHOLE])
    r = row(whole, model="half", group="mag")
    mag = GROUPS["mag"]
    residual = np.concatenate([f.residual[:, mag][f.fresh[:, mag]] for f in TEST])
    assert r["n"] == len(residual)
    assert r["rmse"] == pytest.approx(np.sqrt(np.mean((residual / 2) ** 2)))
    assert r["rmse_before"] == pytest.approx(np.sqrt(np.mean(residual**2)))
    assert r["removed"] == pytest.approx(0.5)
    assert r["removed_beyond_constant"] == pytest.approx(0.5)
    assert row(whole, model="all", group="gyro")["removed"] == pytest.approx(1.0)


@pytest.mark.slow
def test_pooled_by_phase_agrees_with_the_whole() -> None:
    table = table_of(Share(0.5))
    parts = pooled(table[table.phase != WHOLE], ["model", "group"]).set_index(["model", "group"])
    whole = pooled(table[table.phase == WHOLE], ["model", "group"]).set_index(["model", "group"])
    for name in ("n", "mse", "mae", "within_1", "within_2", "inside"):
        np.testing.assert_allclose(parts[name], whole[name], err_msg=name)


# -- what is refused ------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_refused() -> None:
    with pytest.raises(ModelError, match="needs 1 or more"):
        TrainingTask("track", 0)
    with pytest.raises(ModelError, match="leave it 0"):
        TrainingTask("free", 3)
    with pytest.raises(ModelError, match="0 training and 2 test"):
        evaluate(None, [], TEST, FREE)
    with pytest.raises(ModelError, match=r"'flight 0'.*split by flight"):
        evaluate(None, TRAIN, [TRAIN[0]], FREE)
    with pytest.raises(ModelError, match=r"\[50.0, 100.0\] Hz"):
        evaluate(None, TRAIN, [replace(TEST[0], rate_hz=50.0)], FREE)
    with pytest.raises(ModelError, match=r"\['mean'\] are called like baselines"):
        evaluate({"mean": Share(0.5)}, TRAIN, TEST, FREE)
    with pytest.raises(ModelError, match=r"model: .*gyro_x is not finite at 0.000 s of flight 2"):
        evaluate(Share(np.nan), TRAIN, TEST, FREE)
