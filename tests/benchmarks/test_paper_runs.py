"""The paper's tables: scores by hand, a finished training is not done again, every row is there."""

from pathlib import Path

import numpy as np
import pytest
from learning_rigs.compensator_rig import tiny

from benchmarks.compensator import paper
from benchmarks.compensator.trainings import Run, run_all, scores, shortened
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
        np.testing.assert_allclose(
            [said[m] for m in ("mse", "mae", "wasserstein")], [0.01, 0.1, 0.1], rtol=1e-6
        )
    units = np.ones(15)
    units[GROUPS["mag"]] = 1e-4  # gauss in tesla
    expected = float(np.mean(0.1 * spread / units))
    np.testing.assert_allclose(found["hover"]["physical"]["mae"], expected)


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
    assert text.count("| one (n = 1) |") == 3 and "| paper's claim, modality 1 | 0.0012" in text


@pytest.mark.parametrize("table", paper.TABLES)
def test_every_table_names_its_runs(table: str) -> None:
    runs = paper.PRODUCERS[table][0](paper.Options(epochs=7, seeds=2, published=True))
    assert len(runs) >= 6
    assert all(r.preset.epochs == 7 for r in runs)
    assert all(r.test not in r.train for r in runs)
