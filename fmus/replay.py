"""Replay: a recorded flight as an FMU whose outputs are the flight's signals."""

import re
import struct

import numpy as np
from numpy.typing import NDArray

from twin.component import Variable
from twin.errors import LogError
from twin.logs import Flight
from twin.logs.columns import COLUMNS, motor_number

from .model import FmuModel, Submodel

Array = NDArray[np.float64]
GAP_FACTOR = 5.0
"""Length of a gap, in median sample intervals."""


def replay_model(
    flight: Flight, columns: tuple[str, ...], linear: tuple[str, ...] = ()
) -> FmuModel:
    """FMU model that outputs columns of a flight table over time.

    Each column becomes an output of that name and a Boolean `valid.<column>`, false outside
    the record and in gaps. Nothing is extrapolated.

    Args:
        flight: The recorded flight.
        columns: Columns to output.
        linear: Columns with linear interpolation; the others hold the last sample.

    Raises:
        LogError: A column has no sample.
    """
    unknown = set(linear) - set(columns)
    if unknown:
        raise LogError(f"{flight.name}: cannot interpolate {sorted(unknown)}: not replayed.")
    signals = [_signal(flight, name) for name in columns]
    record = b"".join(
        [
            b"UAVTWIN1",
            struct.pack("<Q", len(columns)),
            *(
                struct.pack("<QQd", len(t), name in linear, GAP_FACTOR * _interval(t))
                + t.astype("<f8").tobytes()
                + v.astype("<f8").tobytes()
                for name, (t, v) in zip(columns, signals, strict=True)
            ),
        ]
    )
    outputs = tuple(Variable(name, "output", *_unit_and_meaning(name)) for name in columns)
    validity = tuple(
        Variable(f"valid.{name}", "output", "1", f"Whether {name} is valid now", kind="boolean")
        for name in columns
    )
    nothing = {v.name: () for v in outputs + validity}
    part = Submodel(
        name="replay",
        variables=outputs + validity,
        dependencies=nothing,
        initial_dependencies=nothing,
        state_names=(),
        max_step_s=1e-3,
        glue="replay.h",
        defines={"N_SIGNALS": len(columns)},
        resources={"record.bin": record},
        held=frozenset(columns).difference(linear),
    )
    return FmuModel("replay", f"Recorded flight {flight.name}", (part,))


def _signal(flight: Flight, name: str) -> tuple[Array, Array]:
    time, value = flight.signal([name])
    return time, value[:, 0]


def _interval(time: Array) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def _unit_and_meaning(name: str) -> tuple[str, str]:
    """FMI unit and description of a flight-table column."""
    number = motor_number(name)
    generic = name if number is None else re.sub(r"\d+$", "{i}", name)
    column = next(c for c in COLUMNS if c.name == generic)
    meaning = column.description if number is None else f"{column.description}, i = {number}"
    return column.unit.replace("^", ""), f"Recorded {meaning}"
