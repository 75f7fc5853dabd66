"""Series as MCAP: a topic per side, a field per channel."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.logs.columns import POS

from .foxglove import LOCATION, LocationTopics, PoseTopics
from .mcap_file import PlotTopics, check_times, mcap_file
from .table import CORRECTED, DRAWN, EXPLAINED, MEASURED, TWIN, Series

_BLOCK_ROWS = 1 << 12
PLACED = (MEASURED, TWIN, EXPLAINED, CORRECTED, DRAWN)
"""Sides that are somewhere; the others are differences and spreads."""


def write_series_mcap(series: Series, path: Path, pose: Sequence[str] = ()) -> None:
    """Write series; what stands before the last point of a column's name is its topic.

    Args:
        series: To write.
        path: An existing one is replaced.
        pose: Columns of a position, NED, and of an attitude, body to NED, w first, to be shown as a
            body in space; none: no pose.

    Raises:
        TwinError: The package `mcap` is not installed, or a time is negative.
    """
    topics: dict[str, dict[str, tuple[str, str]]] = {}
    for column in series.columns:
        side, _, name = column.name.rpartition(".")
        topics.setdefault("/" + side.replace(".", "/"), {})[column.name] = name, column.unit
    begun = False
    with mcap_file(path) as file:
        plots, body = PlotTopics(file, topics), PoseTopics(file) if pose else None
        places = LocationTopics(file, series.origin, _positions(series.names))
        file.note("uavtwin", {"name": series.name, **series.facts})
        file.note("units", {c.name: c.unit for c in series.columns})
        for t_ns, values in series.blocks(_BLOCK_ROWS):
            if not begun:
                check_times(series.name, int(t_ns[0]))
                if body is not None:
                    body.begin(int(t_ns[0]))
            begun = True
            block = dict(zip(series.names, values, strict=True))
            poses = np.column_stack([block[c] for c in pose]).tolist() if pose else ()
            of_rows = places.rows(block, len(t_ns))
            for k, (t, messages) in enumerate(zip(t_ns.tolist(), plots.rows(block), strict=True)):
                places.write(t, of_rows[k])
                if body is not None and np.isfinite(poses[k]).all():
                    body.write(t, poses[k][:3], poses[k][3:])
                for topic, message in messages:
                    file.write(topic, t, message)


def _positions(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Columns of a position by topic, of every side that has one and is no difference."""
    sides = dict.fromkeys(name.rpartition(".")[0] for name in names)
    found = {side: tuple(f"{side}.{c}" for c in POS) for side in sides if side in PLACED}
    return {f"/{s}{LOCATION}": columns for s, columns in found.items() if {*columns} <= {*names}}
