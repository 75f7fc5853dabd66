"""What a model was trained on is kept to the last bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learning.data.channels import CHANNELS
from learning.data.flights import ResidualFlight, read_residuals, write_residuals
from twin.errors import ModelError


def _flight(name: str, n: int) -> ResidualFlight:
    rng = np.random.default_rng(n)
    residual = rng.normal(size=(n, len(CHANNELS)))
    residual[:5, 3] = np.nan
    return ResidualFlight(
        name=name,
        rate_hz=100.0,
        t_s=np.arange(n) / 100,
        virtual=rng.normal(size=residual.shape),
        residual=residual,
        fresh=rng.random(residual.shape) < 0.5,
        commands=rng.random((n, 4)),
        phase=rng.integers(0, 6, n).astype(np.intp),
        spans=((2, n // 2), (n // 2, n - 3)),
    )


def test_flights_come_back_to_the_last_bit(tmp_path: Path) -> None:
    flights = [_flight("b", 40), _flight("a", 60)]
    write_residuals(flights, tmp_path / "r.parquet")
    again = read_residuals(tmp_path / "r.parquet")
    assert [f.name for f in again] == ["b", "a"]
    for before, after in zip(flights, again, strict=True):
        assert after.rate_hz == before.rate_hz and after.spans == before.spans
        for name in ("t_s", "virtual", "residual", "fresh", "commands", "phase"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
            assert getattr(after, name).dtype == getattr(before, name).dtype


def test_no_commands_are_no_columns(tmp_path: Path) -> None:
    flight = replace(_flight("a", 30), commands=np.zeros((30, 0)))
    write_residuals([flight], tmp_path / "r.parquet")
    assert read_residuals(tmp_path / "r.parquet")[0].commands.shape == (30, 0)


@pytest.mark.parametrize("content", [None, b"", b"no parquet"])
def test_damage_is_reported(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "r.parquet"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelError, match=r"r\.parquet: the residuals .* train the model again"):
        read_residuals(path)
