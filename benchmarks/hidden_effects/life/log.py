"""What of a flight gets into the log."""

import pandas as pd

from ..plants.own.parameters import Array
from .conditions import SENSORS, Conditions


def as_logged(table: pd.DataFrame, rotor: Array, conditions: Conditions) -> pd.DataFrame:
    """The flight table that is left under some conditions.

    Args:
        table: With all sensors.
        rotor: Speeds of the rotors at its rows, rad/s, shape (k, r).
        conditions: Which sensors are there.
    """
    if conditions.rotors:
        commands = [c for c in table if c.startswith("cmd_")]
        names = [f"rotor_{i + 1}" for i in range(rotor.shape[1])]
        measured = pd.DataFrame(rotor, columns=names)
        table = pd.concat(
            [table[["time"]], measured, table.drop(columns=["time", *commands])], axis=1
        )
    if conditions.without:
        gone = SENSORS[conditions.without]
        table = table[[c for c in table if not c.startswith(gone)]]
    return table
