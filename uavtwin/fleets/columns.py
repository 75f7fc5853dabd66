"""Columns of the dataset: what each table holds, in which unit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import pyarrow as pa

MOTORS = 12
"""Of the largest aircraft that is read."""
Kind = Literal["text", "count", "number", "flag"]
_TYPES: Mapping[Kind, pa.DataType] = {
    "text": pa.string(),
    "count": pa.int64(),
    "number": pa.float64(),
    "flag": pa.bool_(),
}


@dataclass(frozen=True, slots=True)
class Column:
    """One column.

    Attributes:
        name: In the table.
        kind: Of its values; each may be missing.
        unit: As printed, "" where there is none.
        meaning: In a line.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str


def _text(name: str, meaning: str) -> Column:
    return Column(name, "text", "", meaning)


def _count(name: str, meaning: str) -> Column:
    return Column(name, "count", "1", meaning)


_LOG = _text("log", "path of the log, from the folder that all logs have in common")
_AIRCRAFT = _text("aircraft", "as the log names it; empty where it does not")

VITALS = (
    Column("hover_command", "number", "1", "mean command of the motors in hover"),
    Column("hover_speed_rad_s", "number", "rad/s", "mean speed of the rotors in hover"),
    Column("hover_voltage_v", "number", "V", "battery voltage in hover"),
    Column(
        "battery_resistance_ohm",
        "number",
        "ohm",
        "by how much the voltage falls with the current within the flight, its slow fall left out",
    ),
    Column(
        "carried",
        "number",
        "1",
        "thrust of the twin in hover over what the flight shows: below 1 where the aircraft is "
        "lighter or stronger than its twin",
    ),
    Column("back_m", "number", "m", "centre of mass further back than the twin's, from the hover"),
    Column("right_m", "number", "m", "centre of mass further to the right, from the hover"),
    *(
        Column(
            f"gyro_bias_{a}_rad_s",
            "number",
            "rad/s",
            f"gyroscope about {axis} minus how fast the attitude turns, median over the flight",
        )
        for a, axis in zip("xyz", ("roll", "pitch", "yaw"), strict=True)
    ),
    *(
        Column(
            f"motor_{i}",
            "number",
            "1",
            f"command (or speed) of motor {i} in hover over the mean of all, minus 1",
        )
        for i in range(1, MOTORS + 1)
    ),
)
"""Numbers of a flight that tell how the aircraft does, from `check` and `gap` alone."""

TABLES: Mapping[str, Sequence[Column]] = {
    "flights": (
        _LOG,
        Column("bytes", "count", "byte", "size of the log"),
        _text(
            "status",
            "fine; findings: something is damaged in it; refused: read, and of no use for a verb; "
            "unreadable; copy: the same flight as an earlier log; failed: its process ended",
        ),
        _text("error", "why it is unreadable, refused, a copy or failed"),
        _text("format", "of the log"),
        _AIRCRAFT,
        _text("airframe", "kind of airframe as the log names it"),
        _text("hardware", "autopilot as the log names it"),
        _text("vehicle", "name of the vehicle file it was compared with"),
        Column("date_year", "number", "year", "date by the satellites, as a decimal year"),
        Column("duration_s", "number", "s", "of the flight table"),
        _count("rows", "rows of the flight table"),
        _text("fingerprint", "hash of all numbers of the flight"),
        _count("problems", "findings that are errors"),
        _count("warnings", "findings that are warnings"),
        _text("verdict", "of explain: named, nothing, unnamed, cannot_tell, unusable"),
        Column("nothing_probability", "number", "1", "that no effect is missing"),
        _text("named", "effects that explain lists, the most probable first"),
        *VITALS,
    ),
    "channels": (
        _LOG,
        _AIRCRAFT,
        _text("channel", "quantity"),
        _text("phase", "phase of flight; `whole flight`: every phase"),
        _text("unit", "of rms and mean"),
        Column(
            "horizon_s", "number", "s", "since the twin was set to the measured state; 0: at it"
        ),
        _count("n", "samples"),
        Column("rms", "number", "unit", "of measured minus simulated"),
        Column("rms_low", "number", "unit", "lower end of its 95 % interval"),
        Column("rms_high", "number", "unit", "upper end"),
        Column("mean", "number", "unit", "of measured minus simulated"),
        Column("share", "number", "1", "rms over that of the signal about its mean"),
        Column("slow_rms", "number", "unit", "rms of the slow part"),
    ),
    "effects": (
        _text("log", "of which flight; empty where all flights of an aircraft were explained"),
        _AIRCRAFT,
        _text("verdict", "of the explanation; one that lists no effect has one row without any"),
        _text("effect", "name"),
        Column("probability", "number", "1", "that it is missing in the vehicle file"),
        _text("number", "of the effect"),
        Column("value", "number", "unit", "estimate"),
        Column("sd", "number", "unit", "standard deviation; missing where there is none"),
        Column("low", "number", "unit", "lower end of the 95 % interval"),
        Column("high", "number", "unit", "upper end"),
        _text("unit", "of value, sd, low and high"),
        Column("prior_share", "number", "1", "posterior over prior deviation: 1 tells nothing"),
    ),
    "findings": (
        _LOG,
        _AIRCRAFT,
        _text("verb", "that found it: check, gap, explain"),
        _text("severity", "problem, warning or note"),
        _text("text", "what"),
    ),
}
"""Tables of the dataset."""


def schema(table: str) -> pa.Schema:
    """Of a table as Parquet, units in the metadata of its columns."""
    return pa.schema(
        [
            pa.field(
                c.name,
                _TYPES[c.kind],
                metadata={"unit": c.unit, "meaning": c.meaning},
            )
            for c in TABLES[table]
        ]
    )


def row(table: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """A row with all columns of a table, None where nothing is given.

    Raises:
        KeyError: A value has no column.
    """
    names = [c.name for c in TABLES[table]]
    for name in values:
        if name not in names:
            raise KeyError(f"{table} has no column {name}")
    return {name: values.get(name) for name in names}
