"""What an evaluation says of a model: a table, figures, and where a baseline is better."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from operator import itemgetter
from typing import Any

from twin.formatting import number, percent

from .markdown import Table

CORRECTED, ALONE = "model", "linear part alone"
"""What a compensator, and it without its network, are called in the rows of an evaluation."""
SHIPPED = "corrected"
"""What the twin with a learned force is called there."""
CLAIMED_S = 0.5
"""Horizon of the figures of a learned force."""
_SHARES = ("within_1", "within_2", "inside")


@dataclass(frozen=True, slots=True)
class Measured:
    """What `uavtwin evaluate` found.

    Attributes:
        content: Of `evaluation.json`.
        hashes: `Flight.fingerprint` by the name of a flight.
    """

    content: Mapping[str, Any]
    hashes: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Result:
    """Figures of an evaluation.

    Attributes:
        caption: Of the table.
        table: Models beside each other.
        metrics: Of the model itself: `type`, `name`, `value`.
        worse: Where a baseline is better, a text each.
        spread: How far the spread holds that the model predicts; None: it predicts none.
    """

    caption: str
    table: Table
    metrics: tuple[dict[str, Any], ...]
    worse: tuple[str, ...]
    spread: Table | None = None


def result_of(protocol: str, measured: Measured) -> Result:
    """The table of an evaluation, and the figures of the model itself."""
    content = measured.content
    if protocol == "force":
        return _force_result(content)
    what, unit = ("log_spectral_db", "dB") if protocol == "generate" else ("rmse", "")
    groups: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in content["groups"]:
        groups.setdefault(row["group"], {})[row["model"]] = row
    models = list(dict.fromkeys(row["model"] for row in content["groups"]))
    others = [m for m in models if m not in (CORRECTED, ALONE)]
    rows, worse = [], []
    metrics: list[dict[str, Any]] = []
    for group, cells in groups.items():
        left = {m: _known(cells[m][what]) for m in models}
        shown = unit or cells[CORRECTED]["unit"]
        rows.append([group, shown, *(number(left[m]) for m in models)])
        metrics.append({"type": what, "name": f"{group}, {shown}", "value": left[CORRECTED]})
        best, least = min(((m, left[m]) for m in others if isfinite(left[m])), key=itemgetter(1))
        if left[CORRECTED] > least:
            told = f"{best} leaves {number(least)}, it {number(left[CORRECTED])}"
            worse.append(f"{group}: {told} {shown}")
    shares = [
        [group, *(percent(_known(cells[CORRECTED][k])) for k in _SHARES)]
        for group, cells in groups.items()
        if _SHARES[0] in cells[CORRECTED]
    ]
    captions = {
        "rmse": "Rms of the residual that is left",
        "log_spectral_db": "Distance between the spectra of draws and flight, dB",
    }
    return Result(
        captions[what],
        (["sensor", "unit", *models], rows),
        tuple(m for m in metrics if isfinite(m["value"])),
        tuple(worse),
        (["sensor", "within one", "within two", "inside"], shares) if shares else None,
    )


def _force_result(content: Mapping[str, Any]) -> Result:
    """The same of a learned force: how far twins are off after they were left alone."""
    quantities = {"position": "m", "velocity": "m/s", "attitude": "rad", "rates": "rad/s"}
    summed = [r for r in content["summary"] if r["horizon_s"] == CLAIMED_S]
    own = next(r for r in summed if r["model"] == SHIPPED)
    metrics = [
        {"type": "rmse", "name": f"{q} after {CLAIMED_S:g} s, {u}", "value": own[q]}
        for q, u in quantities.items()
    ]
    for kind in ("median", "largest"):
        name = f"over the explained twin after {CLAIMED_S:g} s, {kind} cell"
        metrics.append(
            {"type": "ratio", "name": name, "value": _known(own[f"over_explained_{kind}"])}
        )
    best = {q: min(summed, key=itemgetter(q)) for q in quantities}
    worse = [
        f"{q}: {r['model']} is off by {number(r[q])}, it by {number(own[q])}"
        for q, r in best.items()
        if r[q] < own[q]
    ]
    return Result(
        f"Rms by which a twin is off {CLAIMED_S:g} s after it was left alone",
        (
            ["twin", *(f"{q}, {u}" for q, u in quantities.items())],
            [[r["model"], *(number(r[q]) for q in quantities)] for r in summed],
        ),
        tuple(m for m in metrics if isfinite(m["value"])),
        tuple(worse),
    )


def inside_table(content: Mapping[str, Any]) -> Table | None:
    """Of a learned force: how often it was inside its envelope; None of others."""
    if "inside" not in content:
        return None
    header = ["flight", *(f"after {h:g} s" for h in content["horizons_s"])]
    return header, [[f, *(percent(s) for s in shares)] for f, shares in content["inside"].items()]


def evaluated(measured: Measured) -> list[list[str]]:
    """Flights of an evaluation, by hash."""
    return [[name, measured.hashes[name]] for name in measured.content["flights"]]


def _known(value: float | None) -> float:
    """A figure of JSON; NaN where it is not defined."""
    return nan if value is None else value
