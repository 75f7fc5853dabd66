"""The paper's tables as the pages show them: its printed numbers beside ours, as Markdown.

The paper numbers two modalities and does not say which is which; by its published code 1 is hover
and 2 takeoff. Nor does it say in which units its numbers are: ours are standardised here, other
units are in the file of the scores. The column that it heads RMSE is a mean square: it is below the
mean absolute error in 28 of 84 cells, as no root mean square is.
"""

import csv
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from scipy.stats import spearmanr

from learning.preset import BEST, PAPER

from .comparison import NEEDED, TRIVIAL, WEIGHTS, Row
from .trainings import MODALITIES, SYSTEMS

PRINTED = Path(__file__).with_name("printed.csv")
"""Every number of the paper's Tables II to V and of its claimed improvements."""
_MODALITY = {"takeoff": "2", "hover": "1"}
_METRICS = {"mse": "RMSE", "mae": "MAE", "wasserstein": "WD"}
"""Ours, and how the paper heads them."""
_FLOWN = {"takeoff": "takeoff", "hovering": "hover", "tour": "", "forward": ""}
"""Missions as the paper's claims name them, and ours; of two there is no public real flight."""
PROPOSED = "Proposed"
"""The paper's own network."""
MULTICHANNEL = {"autofiltervq": "AutoFilterVQ", "contrastvq": "ContrastVQ", "mcvq": "MCVQ"}
NAMES = {n: MULTICHANNEL.get(n, n.upper()) for n in SYSTEMS} | {"timeddpm": "TimeDDPM"}
"""Of the thirteen systems, as the paper prints them."""


@cache
def printed() -> dict[tuple[str, str, str, str, str], float]:
    """By table, row, modality, metric and percent of the data."""
    with PRINTED.open(encoding="utf-8") as file:
        keys = ("table", "row", "modality", "metric", "data_percent")
        return {
            (r[keys[0]], r[keys[1]], r[keys[2]], r[keys[3]], r[keys[4]]): float(r["value"])
            for r in csv.DictReader(file)
        }


def paper_cell(table: str, row: str, modality: str, share: float = 1.0) -> str:
    """The paper's three numbers, "-" where it has none."""
    percent, number = f"{100 * share:.0f}", _MODALITY[modality]
    found = [printed().get((table, row, number, m, percent)) for m in _METRICS.values()]
    return " / ".join(f"{v:g}" for v in found if v is not None) or "-"


def our_cell(row: Row, modality: str) -> str:
    """The same numbers of ours, standardised, with the standard deviation of several seeds."""
    scores = row["scores"][modality]["standardised"]
    return " / ".join(_number(scores[m]) for m in _METRICS if m in scores)


def _number(value: Sequence[float | None]) -> str:
    mean, spread = value
    assert mean is not None
    text = f"{mean:.2g}" if mean < 1 else f"{mean:.3g}"
    text = text if mean else "below 1e-6"
    return text if spread is None else f"{text} ± {spread:.1g}"


def picked(rows: Sequence[Row], **wanted: Any) -> list[Row]:
    """Rows that have these values."""
    return [r for r in rows if all(r.get(k) == v for k, v in wanted.items())]


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = (head, ["---"] * len(head), *lines)
    return "".join(f"| {' | '.join(r)} |\n" for r in rows)


def table2(rows: Sequence[Row], share: float) -> str:
    """Each system with the paper's row beside ours."""
    ours = {r["row"]: r for r in picked(rows, table="II", role="reconstruct", share=share)}
    shown = {PAPER.name: PROPOSED, BEST.name: PROPOSED, "best, no quantiser": ""}
    shown |= {n: NAMES[n] for n in SYSTEMS} | dict.fromkeys(TRIVIAL.values(), "")
    lines = []
    for name, theirs in shown.items():
        cells = [f"{name} (n = {ours[name]['n']})"]
        for modality in MODALITIES:
            cells += [paper_cell("II", theirs, modality, share), our_cell(ours[name], modality)]
        lines.append(cells)
    head = [f"{m}, {who}" for m in MODALITIES for who in ("paper", "here")]
    return _table(("MSE / MAE / WD", *head), lines)


def order(rows: Sequence[Row]) -> str:
    """Rank correlation between the paper's order of the thirteen systems and ours."""
    lines = []
    for share in (1.0, 0.5, 0.25):
        ours = {r["row"]: r for r in picked(rows, table="II", role="reconstruct", share=share)}
        lines.append([f"{100 * share:.0f} %", *_correlations(ours, f"{100 * share:.0f}")])
    heads = [f"{m}, {k.upper()}" for m in MODALITIES for k in ("mse", "mae", "wd")]
    return _table(("data", *heads), lines)


def _correlations(ours: dict[str, Row], percent: str) -> Iterator[str]:
    for modality in MODALITIES:
        for metric, headed in _METRICS.items():
            theirs = [
                printed()["II", NAMES[n], _MODALITY[modality], headed, percent] for n in SYSTEMS
            ]
            own = [ours[n]["scores"][modality]["standardised"][metric][0] for n in SYSTEMS]
            yield f"{spearmanr(theirs, own).statistic:.2f}"


def drawn(rows: Sequence[Row], share: float) -> str:
    """What each draws: distance of the distributions, and of the spectra."""
    head = [f"{m}: RMSE of mean / WD / spectrum, dB" for m in MODALITIES]
    lines = []
    for row in (r for r in picked(rows, table="II", share=share) if "drawn" in r):
        found = [row["drawn"][m]["standardised"] for m in MODALITIES]
        cells = [
            f"{f['rmse'][0]:.2f} / {f['wasserstein'][0]:.2f} / {f['spectral_db'][0]:.0f}"
            for f in found
        ]
        lines.append([row["row"], *cells])
    return _table(("draws", *head), lines)


def table3(rows: Sequence[Row]) -> str:
    """Small samples: the paper's row and ours."""
    shares = (1.0, 0.6, 0.3, 0.1)
    lines = []
    for modality in MODALITIES:
        lines.append(
            [f"{modality}, paper", *(paper_cell("III", PROPOSED, modality, s) for s in shares)]
        )
        for name in (PAPER.name, BEST.name):
            found = {r["share"]: r for r in picked(rows, table="III", row=name)}
            lines.append(
                [f"{modality}, {name} (n = 3)", *(our_cell(found[s], modality) for s in shares)]
            )
    return _table(("MSE / MAE / WD", *(f"{100 * s:.0f} %" for s in shares)), lines)


def table5(rows: Sequence[Row], table: str = "V") -> str:
    """Weights of the losses: the paper's row beside ours, "-" where one of them has none."""
    own = {r["row"]: r for r in picked(rows, table=table)}
    names = ("gamma_VAE",) if table == "gamma_VAE" else ("gamma_vq", "distribution")
    wanted = [f"{w} {v}" for w in names for v in WEIGHTS]
    lines = []
    for preset in (PAPER.name, BEST.name):
        for what in ("", *wanted):
            name = f"{preset}, {what}" if what else preset
            row, theirs = own.get(name), what.replace(" ", "=")
            cells = [f"{name} (n = {row['n']})" if row else name]
            for m in MODALITIES:
                cells.append(paper_cell("V", theirs, m) if what else paper_cell("II", PROPOSED, m))
                cells.append(our_cell(row, m) if row else "-")
            lines.append(cells)
    head = [f"{m}, {who}" for m in MODALITIES for who in ("paper", "here")]
    return _table(("MSE / MAE / WD", *head), lines)


def improvements(rows: Sequence[Row]) -> str:
    """Share of the rms removed: the paper's highest of any sensor, ours of the mean channel."""
    claims = {k[1].rpartition(" ")[2]: v for k, v in printed().items() if k[0] == "claim"}
    ours = {r["row"]: r for r in picked(rows, table="II", role="reconstruct", share=1.0)}
    lines = [["paper, highest of any sensor", *(f"{claims[m]:.1f}" for m in _FLOWN)]]
    for name in (PAPER.name, BEST.name, TRIVIAL["mean"], TRIVIAL["average"]):
        cells = [name]
        for modality in _FLOWN.values():
            if not modality:
                cells.append("-")
                continue
            left, whole = (
                ours[n]["scores"][modality]["standardised"]["rmse"][0]
                for n in (name, TRIVIAL["none"])
            )
            cells.append(f"{100 * (1 - left / whole):.1f}")
        lines.append(cells)
    lines.append(["the sample that is given, handed back", *(["100.0"] * len(_FLOWN))])
    return _table(("removed, %", *_FLOWN), lines)


def table4(rows: Sequence[Row]) -> str:
    """Cost of each system in onnxruntime, beside the paper's edge device."""
    claim = {k[3]: v for k, v in printed().items() if k[0] == "IV"}
    device = (f"{claim['inference_ms']:g}", f"{claim['cpu_memory_mb']:g}")
    lines = [["paper, its edge device", "", "", *device]]
    lines += [
        [
            r["row"],
            str(r["samples"]),
            str(r["weights"]),
            f"{r['ms']:.4f}",
            "" if r["memory_mb"] is None else f"{r['memory_mb']:.0f}",
        ]
        for r in picked(rows, table="IV")
    ]
    return _table(("system", "samples a call", "numbers", "ms a sample", "memory, MB"), lines)


def needed(rows: Sequence[Row]) -> str:
    """RMSE where the answer is not given, standardised."""
    own = picked(rows, table="needed")
    lines = []
    for name in dict.fromkeys(r["row"] for r in own):
        cells = [name]
        for role, _ in NEEDED.values():
            one = picked(own, row=name, role=role)
            for m in MODALITIES:
                value = one[0]["scores"][m]["standardised"]["rmse"][0] if one else None
                cells.append("-" if value is None else f"{value:.3f}")
        lines.append(cells)
    return _table(("RMSE", *(f"{c}, {m}" for c in NEEDED for m in MODALITIES)), lines)


def ablations(rows: Sequence[Row]) -> str:
    """MSE of each variant by share of the data."""
    own, shares = picked(rows, table="ablations"), (1.0, 0.5, 0.25)
    lines = []
    for name in dict.fromkeys(r["row"] for r in own):
        found = {r["share"]: r["scores"] for r in picked(own, row=name)}
        cells = [
            " / ".join(_number(found[s][m]["standardised"]["mse"]) for m in MODALITIES)
            for s in shares
        ]
        lines.append([name, *cells])
    return _table(("MSE, takeoff / hover", *(f"{100 * s:.0f} %" for s in shares)), lines)


def published(rows: Sequence[Row]) -> str:
    """The published code's choices, in every system of units."""
    lines = []
    for row in picked(rows, table="published"):
        for units in row["scores"]["takeoff"]:
            cells = [
                " / ".join(_number(row["scores"][m][units][k]) for k in _METRICS)
                for m in MODALITIES
            ]
            lines.append([row["row"], units, *cells])
    return _table(("MSE / MAE / WD", "units", *MODALITIES), lines)


def made_by(rows: Sequence[Row], table: str, **wanted: Any) -> str:
    """Commits that scored the rows of a table."""
    commits = dict.fromkeys(r["commit"] for r in picked(rows, table=table, **wanted))
    return ", ".join(f"`{c}`" for c in commits)
