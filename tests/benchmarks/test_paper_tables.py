"""The paper's tables: columns in their places, SI units, sign, and what is refused."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.paper.trainings import RATE_HZ, paper_flights
from learning.data.channels import CHANNELS, PHASE_CODES
from twin.errors import LogError

_COLUMNS = [
    *(f"gyro_{a}" for a in "xyz"),
    *(f"acc_{a}" for a in "xyz"),
    *(f"mag_{a}" for a in "xyz"),
    *"xyz",
    *(f"v{a}" for a in "xyz"),
]


def write(folder: Path, name: str, rows: int, first: float = 0.0) -> None:
    """Real readings count up by column; simulated ones are half of them."""
    real = np.arange(len(_COLUMNS)) + np.arange(first, first + rows)[:, None]
    table = pd.DataFrame(real, columns=[f"real_{c}" for c in _COLUMNS])
    table[[f"sim_{c}" for c in _COLUMNS]] = real / 2
    table[["real_ax", "sim_ax"]] = 1e9  # further columns do not matter
    table.sample(frac=1, axis=1, random_state=0).to_parquet(folder / f"{name}.parquet")


def test_columns_units_and_sign(tmp_path: Path) -> None:
    write(tmp_path, "takeoff_flight2", 5)
    write(tmp_path, "hover_flight2", 7, first=100.0)
    (flight,) = paper_flights(tmp_path, [2])
    assert flight.name == "flight_2"
    assert flight.spans == ((0, 5), (5, 12))
    assert flight.phase.tolist() == [PHASE_CODES["takeoff"]] * 5 + [PHASE_CODES["hover"]] * 7
    real = np.arange(15) + np.concatenate([np.arange(5), np.arange(100, 107)])[:, None]
    scaled = np.where(["mag" in c for c in CHANNELS], 1e-4, 1.0) * real
    np.testing.assert_allclose(flight.virtual, scaled / 2, rtol=1e-12)
    np.testing.assert_allclose(flight.residual, scaled / 2, rtol=1e-12)  # real minus sim
    assert flight.fresh.all()
    assert flight.commands.shape == (12, 0)
    assert np.allclose(np.diff(flight.t_s), 1 / RATE_HZ)


def test_recorded_tables(data_dir: Path) -> None:
    flights = paper_flights(data_dir / "rflysimdt" / "paper_residuals")
    assert [[b - a for a, b in f.spans] for f in flights] == [[858, 3357], [826, 3348], [862, 3481]]
    for flight in flights:
        strength = np.linalg.norm(flight.virtual[:, 6:9] + flight.residual[:, 6:9], axis=1)
        assert np.all((strength > 5e-5) & (strength < 2e-4))  # tesla, as anywhere on earth
        height = -(flight.virtual[:, 11] + flight.residual[:, 11])
        assert 0.5 < height.max() < 2.0
        gravity = -(flight.virtual[:, 5] + flight.residual[:, 5])
        assert gravity.mean() == pytest.approx(9.81, abs=0.3)


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"takeoff_flight1\.parquet.*no such file"):
        paper_flights(tmp_path)
    write(tmp_path, "takeoff_flight1", 3)
    write(tmp_path, "hover_flight1", 3)
    path = tmp_path / "hover_flight1.parquet"
    table = pd.read_parquet(path)
    table.drop(columns=["sim_vx"]).to_parquet(path)
    with pytest.raises(LogError, match="no columns sim_vx"):
        paper_flights(tmp_path, [1])
    table.loc[1, "real_z"] = np.nan
    table.to_parquet(path)
    with pytest.raises(LogError, match="not finite"):
        paper_flights(tmp_path, [1])
