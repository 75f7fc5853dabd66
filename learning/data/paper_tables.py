"""The tables that the paper's network was trained on, as residual flights.

One parquet file per phase and flight (`takeoff_flight1`, `hover_flight1`, ...), columns `real_*`
and `sim_*` side by side: gyro rad/s, acc m/s2, mag gauss, x..z m, vx..vz m/s, PX4 frames.

They hold no time: the authors stretched a real and an unrelated simulated flight by sample index to
the same length, slow sensors on straight lines to the *next* sample. Whatever is one step ahead
is flattered by that. For comparison with the paper's Table II, and nothing else.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.errors import LogError
from twin.logs.stored import damage_told, opened

from .channels import CHANNELS, PHASE_CODES
from .flights import ResidualFlight

Array = NDArray[np.float64]
RATE_HZ = 166.0
"""Nominal: that of the real flights' IMU before they were stretched by index."""
PHASES = ("takeoff", "hover")
FLIGHTS = (1, 2, 3)
GAUSS_T = 1e-4
_STEMS = {"gyro_": "gyro_", "acc_": "acc_", "mag_": "mag_", "pos_": "", "vel_": "v"}


def paper_flights(folder: Path, flights: Sequence[int] = FLIGHTS) -> list[ResidualFlight]:
    """Residuals of the paper's flights, named flight_1, flight_2, ...

    Takeoff and hover are two spans of one flight, one after the other; there are no commands.

    Args:
        folder: Holds `takeoff_flight1.parquet` and so on.
        flights: Their numbers.

    Raises:
        LogError: A file or a column is missing, or a number is not finite.
    """
    return [_flight(folder, number) for number in flights]


def _flight(folder: Path, number: int) -> ResidualFlight:
    tables = [_read(folder / f"{phase}_flight{number}.parquet") for phase in PHASES]
    sizes = [len(real) for real, _ in tables]
    ends = np.cumsum(sizes)
    real, virtual = (np.vstack(part) for part in zip(*tables, strict=True))
    return ResidualFlight(
        name=f"flight_{number}",
        rate_hz=RATE_HZ,
        t_s=np.arange(ends[-1]) / RATE_HZ,
        virtual=virtual,
        residual=real - virtual,
        fresh=np.ones(real.shape, dtype=np.bool_),
        commands=np.zeros((ends[-1], 0)),
        phase=np.repeat(np.array([PHASE_CODES[p] for p in PHASES], dtype=np.intp), sizes),
        spans=tuple((int(e - n), int(e)) for e, n in zip(ends, sizes, strict=True)),
        notes=("stretched by sample index by the paper's authors; the rate is nominal",),
    )


def _read(path: Path) -> tuple[Array, Array]:
    """Real and simulated readings, SI units, shape (n, 15) each."""
    if not path.is_file():
        raise LogError(
            f"{path}: there is no such file. Give the folder with the paper's residual tables, "
            f"takeoff_flight1.parquet and so on."
        )
    with opened(path, path.name) as file, damage_told(path.name):
        table = file.read().to_pandas()
    found = []
    for side in ("real_", "sim_"):
        columns = [side + _STEMS[c[:-1]] + c[-1] for c in CHANNELS]
        missing = [c for c in columns if c not in table]
        if missing:
            raise LogError(f"{path.name}: no columns {', '.join(missing)}.")
        values = table[columns].to_numpy(dtype=np.float64, copy=True)
        values[:, [c.startswith("mag") for c in CHANNELS]] *= GAUSS_T
        if not np.isfinite(values).all():
            raise LogError(f"{path.name}: a number is not finite; copy the file again.")
        found.append(values)
    return found[0], found[1]
