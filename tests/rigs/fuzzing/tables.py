"""Flight tables, Parquet and CSV: columns changed, and the text or the bytes around them."""

import io
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from places import DATA
from sample_logs import flight_table, flown_table

from twin.logs import read_flight

from .engine import Seen, Step
from .flights import ABSURD, apply_bytes, draw_bytes, read
from .layout import AXIS_FAULTS, axis_fault, draw_axis_fault

_NOTES = ("[" * 50_000, '{"findings": [{"count": null}]}', '{"site": 3}', "{", '{"facts": []}')
_NAMES = ("cmd_" + "9" * 5000, "acc_X", "", "time", "\x00", "x" * 100_000, "phase", "cmd_13")
_CELLS = 1_500_000  # more takes longer to write than to read
_RECORDED = ("real_1", "sim_2")
"""Logs that are bases as tables, too, where there are recorded flights."""
_VECTORS = ("acc", "gyro", "pos", "vel", "q")


def _to_parquet(frame: pd.DataFrame) -> bytes:
    file = io.BytesIO()
    pq.write_table(pa.Table.from_pandas(frame, preserve_index=False), file)
    return file.getvalue()


def _to_csv(frame: pd.DataFrame) -> bytes:
    text: str = frame.to_csv(index=False, lineterminator="\n")
    return text.encode()


@cache
def _frames() -> dict[str, pd.DataFrame]:
    logs = [p for name in _RECORDED for p in DATA.glob(f"rflysimdt/{name}.ulg")]
    read = {p.stem: read_flight(p).table for p in logs}
    return {"rest": flight_table(), "flown": flown_table(), **read}


@dataclass(frozen=True)
class Tables:
    """The kind in one of its formats."""

    file: str
    write: Callable[[pd.DataFrame], bytes]
    load: Callable[[io.BytesIO], pd.DataFrame]
    visible: frozenset[str] = frozenset(
        {"scale", "gap", "ends", "freeze", "absurd", "sign", "shuffle", "time_times"}
        | {*AXIS_FAULTS}
    )

    def bases(self) -> dict[str, bytes]:
        """Of code alone, and what was recorded."""
        return {name: self.write(frame) for name, frame in _frames().items()}

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Most of them know the format."""
        try:
            frame = self.load(io.BytesIO(blob))
        except Exception:  # changed beyond reading already
            return draw_bytes(rng, blob)
        if rng.random() < 0.3:
            return draw_bytes(rng, blob)
        stems = [s for s in _VECTORS if any(c.startswith(f"{s}_") for c in map(str, frame))]
        if "vel" not in stems or "q" not in stems:
            stems = []
        names = ["cell", "rows", "wide", "name", "text", "note"]
        names += (
            [
                "scale",
                "gap",
                "ends",
                "freeze",
                "absurd",
                "sign",
                "shuffle",
                "time_times",
                *AXIS_FAULTS,
            ]
            if stems
            else []
        )
        name = rng.choice(names)
        columns = [str(c) for c in frame]
        stem = rng.choice(stems) if stems else ""
        given: dict[str, Any] = {}
        match name:
            case "cell":
                given = {
                    "column": rng.choice(columns),
                    "row": rng.random(),
                    "to": repr(rng.choice(ABSURD)),
                }
            case "rows":
                given = {"times": rng.choice((2, 50)), "sorted": rng.random() < 0.5}
            case "wide":
                given = {"columns": rng.choice((100, 5000))}
            case "name":
                given = {"column": rng.choice(columns), "to": rng.choice(_NAMES)}
            case "text":
                given = {
                    "column": rng.choice(columns),
                    "to": rng.choice(("hover", "0x10", "1,5", "'", '"', "\n", "nan", "NULL")),
                    "times": rng.choice((1, 100_000)),
                }
            case "note":
                given = {"text": rng.choice(_NOTES)}
            case "scale":
                low, high = rng.choice(
                    (("vel", 1e10), ("pos", 1e3), ("acc", 0.10197), ("gyro", 57.3))
                )
                given = {"stem": low, "by": high}
            case "gap":
                given = {"stem": stem, "at": rng.uniform(0.1, 0.8)}
            case "ends":
                given = {"stem": stem, "at": rng.uniform(0.1, 0.9)}
            case "freeze":
                given = {"stem": stem, "from": rng.uniform(0.1, 0.3)}
            case "absurd":
                column = rng.choice([c for c in columns if c.startswith(f"{stem}_")])
                given = {"column": column, "to": repr(rng.choice((1e38, 1e308, 1e10)))}
            case "sign":
                given = {"column": rng.choice(("acc_z", "vel_x", "vel_z", "pos_y", "pos_z"))}
            case "axis_sign" | "axis_scale" | "axis_freeze":
                axes = [c for c in columns if c[:-1] in ("acc_", "gyro_", "vel_")]
                column = rng.choice(axes)
                t_s, values = (
                    pd.to_numeric(frame[c], errors="coerce").to_numpy(np.float64)
                    for c in ("time", column)
                )
                given = {"column": column}
                given |= draw_axis_fault(rng, name, column[:-2], t_s, values)
            case "shuffle":
                given = {"stem": rng.choice(("q", "vel", "gyro")), "seed": rng.getrandbits(32)}
            case "time_times":
                given = {"by": rng.choice((1e3, 1e6))}
        return name, given

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; a file that cannot be read any more is left."""
        name, given = step
        if name in ("flip", "cut", "repeat", "remove"):
            return apply_bytes(blob, step)
        try:
            frame = self.load(io.BytesIO(blob))
            if name == "note" and self is PARQUET:
                table = pa.Table.from_pandas(frame).replace_schema_metadata(
                    {"uavtwin": given["text"]}
                )
                file = io.BytesIO()
                pq.write_table(table, file)
                return file.getvalue()
            return self.write(_changed(frame, name, given))
        except Exception:  # of pandas or pyarrow, on what earlier changes left
            return blob

    def read(self, path: Path) -> Seen:
        """As a flight."""
        return read(path)


def _changed(frame: pd.DataFrame, name: str, given: dict[str, Any]) -> pd.DataFrame:
    """A frame with one change."""
    n = len(frame)
    more_rows, more_columns = given.get("times", 1), given.get("columns", 0)
    if name in ("rows", "wide") and n * more_rows * (len(frame.columns) + more_columns) > _CELLS:
        return frame
    frame = frame.copy()
    stem = [c for c in frame if str(c).startswith(f"{given.get('stem', '')}_")]
    match name:
        case "cell":
            frame.loc[int(given["row"] * n), given["column"]] = float(given["to"])
        case "rows":
            frame = pd.concat([frame] * given["times"], ignore_index=True)
            if given["sorted"]:
                frame["time"] = 0.01 * np.arange(len(frame))
        case "wide":
            more = {f"my_own_{i}": np.zeros(n) for i in range(given["columns"])}
            frame = pd.concat([frame, pd.DataFrame(more)], axis=1)
        case "name":
            frame = frame.rename(columns={given["column"]: given["to"]})
        case "text":
            frame[given["column"]] = frame[given["column"]].astype(str)
            frame.loc[n // 2, given["column"]] = given["to"] * given["times"]
        case "scale":
            frame[stem] *= given["by"]
        case "gap":
            begin = int(given["at"] * n)
            frame.loc[begin : begin + max(n // 60, 40), stem] = np.nan
        case "ends":
            frame.loc[int(given["at"] * n) :, stem] = np.nan
        case "freeze":
            begin = int(given["from"] * n)
            frame.loc[begin : begin + n * 2 // 3, stem] = frame.loc[begin, stem].to_numpy()
        case "absurd":
            frame.loc[n // 3 :, given["column"]] = float(given["to"])
        case "sign":
            frame[given["column"]] *= -1.0
        case "axis_sign" | "axis_scale" | "axis_freeze":
            values = frame[given["column"]].to_numpy(dtype=np.float64)
            frame[given["column"]] = axis_fault(values, name, given)
        case "shuffle":
            order = np.random.default_rng(given["seed"]).permutation(n)
            frame[stem] = frame[stem].to_numpy()[order]
        case "time_times":
            frame["time"] *= given["by"]
    return frame


PARQUET = Tables("input.parquet", _to_parquet, pd.read_parquet)
CSV = Tables("input.csv", _to_csv, pd.read_csv)
