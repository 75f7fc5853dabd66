"""The paper's tables: scores by hand, a finished training is not done again, every row is there."""

from pathlib import Path

import numpy as np
import pytest
from learning_rigs.compensator_rig import tiny

from benchmarks.compensator import paper
from benchmarks.compensator.trainings import (
    METRICS,
    RECORDING,
    Run,
    drawn_scores,
    run_all,
    scores,
    shortened,
)
from learning.data.channels import GROUPS
from learning.data.paper_tables import paper_flights

SMALL = tiny(name="small", clustering="none", epochs=2)


@pytest.fixture(scope="module")
def tables(data_dir: Path) -> Path:
    return data_dir / "rflysimdt" / "paper_residuals"


def test_scores_in_three_systems_of_units(tables: Path) -> None:
    """A correction that is off by a tenth of the unit everywhere."""
    flights = paper_flights(tables)
    away = flights[2]
    spread = np.concatenate([f.residual for f in flights[:2]]).std(axis=0)
    found = scores([away.residual + 0.1 * spread], [away], flights[:2], flights)
    for modality in ("takeoff", "hover"):
        said = found[modality]["standardised"]
        np.testing.assert_allclose([said[m] for m in METRICS], [0.01, 0.1, 0.1, 0.1], rtol=1e-6)
    units = np.ones(15)
    units[GROUPS["mag"]] = 1e-4  # gauss in tesla
    expected = float(np.mean(0.1 * spread / units))
    np.testing.assert_allclose(found["hover"]["physical"]["mae"], expected)


def test_draws_are_scored_by_their_mean_and_each_by_its_distribution(tables: Path) -> None:
    """Two draws, a tenth of the unit above and below what was measured."""
    flights = paper_flights(tables)
    away = flights[2]
    spread = np.concatenate([f.residual for f in flights[:2]]).std(axis=0)
    draws = [[away.residual + sign * 0.1 * spread] for sign in (-1, 1)]
    found = drawn_scores(draws, [away], flights[:2], flights)
    for modality in ("takeoff", "hover"):
        said = found[modality]["standardised"]
        assert said["rmse"] == pytest.approx(0.0, abs=1e-12)
        assert said["wasserstein"] == pytest.approx(0.1)
        assert said["spectral_db"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_what_draws_stands_in_a_table_of_its_own(tables: Path, tmp_path: Path) -> None:
    """A system that learns to draw apart, one that draws by what it learned, a recording."""
    options = paper.Options(epochs=1, seeds=1, published=False, shares=(0.1,))
    wanted = ("wgan", "vqvae", paper.RECORDED)
    runs = [r for r in paper.table2(options) if r.name in wanted]
    assert [(r.model, r.protocol) for r in runs] == [
        ("vqvae", "reconstruct"),
        ("wgan", "reconstruct"),
        ("wgan", "generate"),
        (RECORDING, "generate"),
    ]
    made, drawn = paper.table2_text(run_all(tables, tmp_path, runs)).split("### `generate`", 1)
    assert [n for n in wanted if f"| {n} (n = 1) |" in made] == ["wgan", "vqvae"]
    assert [n for n in wanted if f"| {n} (n = 1) |" in drawn] == list(wanted)


def test_less_data_is_the_start_of_each_phase(tables: Path) -> None:
    flight = paper_flights(tables, (1,))[0]
    half = shortened(flight, 0.5)
    assert half.spans == ((0, 429), (858, 858 + 1678))
    assert half.fresh[:429].all() and not half.fresh[429:858].any()


@pytest.mark.slow
def test_a_training_is_done_once(
    tables: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [Run("one", SMALL, share=0.1), Run("same by another name", SMALL, share=0.1)]
    first = run_all(tables, tmp_path, runs)
    assert "1 trainings, 1 to be done" in capsys.readouterr().err
    assert first == run_all(tables, tmp_path, runs)
    assert "1 trainings, 0 to be done" in capsys.readouterr().err
    assert [f["run"]["name"] for f in first] == [r.name for r in runs]
    assert list(tmp_path.glob("models/*")) == []
    text = paper.table2_text(first)
    assert "| one (n = 1) |" in text
    assert "| paper's claim, modality 1, RMSE read as MSE | 0.0012 | 0.0346 |" in text
    assert "| paper's claim, modality 1, RMSE as headed | 0.000001 | 0.0012 |" in text


@pytest.mark.parametrize("table", paper.TABLES)
def test_every_table_names_its_runs(table: str) -> None:
    runs = paper.PRODUCERS[table][0](paper.Options(epochs=7, seeds=2, published=True))
    assert len(runs) >= 6
    assert {getattr(r.preset, "epochs", 7) for r in runs} == {7}
    assert all(r.test not in r.train for r in runs)
