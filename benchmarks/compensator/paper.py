"""The paper's tables beside ours: `python -m benchmarks.compensator.paper --data D --out OUT`.

D holds the paper's residual tables (takeoff_flight1.parquet, ...). Each table names the runs it is
made of; `--epochs` shortens all of them, `--only` picks tables, and a run that is done is not done
again. The tables are printed as Markdown and written to OUT/paper.md.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from learning.preset import BEST, PAPER, PUBLISHED, SEEDS, Preset

from .trainings import ALL, METRICS, MODALITIES, SYSTEMS, Run, run_all

CLAIMED = {"modality 1": (0.0012, 0.0165, 0.0137), "modality 2": (0.0047, 0.0315, 0.0231)}
"""The proposed model in Table II: MSE (headed RMSE), MAE, Wasserstein. The published code numbers
hover 1 and takeoff 2; the paper does not say."""
TABLES = ("table2", "folds", "ablations", "samples", "weights")
SHARES = {"ablations": (1.0, 0.5, 0.25), "samples": (1.0, 0.6, 0.3, 0.1)}
ABLATIONS: dict[str, dict[str, Any]] = {
    "full": {},
    "without clustering (by sensor)": {"clustering": "sensors"},
    "clustering by k-means": {"clustering": "kmeans"},
    "without channels (one network)": {"clustering": "none"},
    "one network per channel": {"clustering": "channels"},
    "hard VQ": {"quantiser": "hard"},
    "hard VQ, no linear path": {"quantiser": "hard", "skip": False},
    "no linear path": {"skip": False},
    "codebook as published": {"codebook_start": "uniform"},
    "code detached": {"straight_through": True},
    "no quantiser": {"quantiser": "none"},
}
WEIGHTS = ((1, 1, 1), (1, 0.25, 1), (1, 1, 0.25), (1, 0.25, 0.25), (1, 0, 1), (1, 1, 0), (1, 0, 0))
"""Of reconstruction, quantiser, distribution. Which ones the paper tried is not known here."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says.

    Attributes:
        epochs: Of every run; None: the preset's.
        seeds: Runs of each row of the main table.
        published: Also the published code's preset, on its own terms.
    """

    epochs: int | None
    seeds: int
    published: bool

    def shortened(self, preset: Preset) -> Preset:
        """The preset with the asked number of epochs."""
        return preset if self.epochs is None else replace(preset, epochs=self.epochs)


def table2(options: Options) -> list[Run]:
    """Paper's text, best, best without its quantiser; trained on flights 1 and 2, tested on 3."""
    rows = {
        "paper": PAPER,
        "best": BEST,
        "best, no quantiser": replace(BEST, quantiser="none"),
    }
    runs = [
        Run(name, options.shortened(preset), seed)
        for name, preset in rows.items()
        for seed in range(SEEDS.get(name, 0), SEEDS.get(name, 0) + options.seeds)
    ]
    if options.published:
        own = replace(options.shortened(PUBLISHED), stride=40)
        runs.append(Run("published, held out", own))
        runs.append(Run("published, training windows", own, train=ALL, test=0))
        runs.append(Run("best, training windows", options.shortened(BEST), train=ALL, test=0))
    return runs


def folds(options: Options) -> list[Run]:
    """`best` with each flight held out in turn: flight 3 was looked at when it was made."""
    return [
        Run(
            f"best, flight {k} held out",
            options.shortened(BEST),
            seed,
            train=tuple(n for n in ALL if n != k),
            test=k,
        )
        for k in ALL
        for seed in range(options.seeds)
    ]


def ablations(options: Options) -> list[Run]:
    """One switch turned, with less and less data."""
    found = []
    for preset in (PAPER, BEST):
        for name, change in ABLATIONS.items():
            turned = replace(preset, **change)
            if name == "full" or turned != preset:
                found += [
                    Run(f"{preset.name}: {name}", options.shortened(turned), share=share)
                    for share in SHARES["ablations"]
                ]
    return found


def samples(options: Options) -> list[Run]:
    """Fewer and fewer samples."""
    return [
        Run(preset.name, options.shortened(preset), share=share)
        for preset in (PAPER, BEST)
        for share in SHARES["samples"]
    ]


def weights(options: Options) -> list[Run]:
    """Weights of the losses."""
    return [
        Run(
            f"{preset.name}: {r:g} / {q:g} / {d:g}",
            replace(
                options.shortened(preset),
                weight_reconstruction=float(r),
                weight_quantiser=float(q),
                weight_distribution=float(d),
            ),
        )
        for preset in (PAPER, BEST)
        for r, q, d in WEIGHTS
    ]


def table2_text(found: Sequence[dict[str, Any]]) -> str:
    """The main table, in every system of units."""
    lines = []
    for system in SYSTEMS:
        lines += [f"### {TITLES[system]}", "", *_head("model", "CPU s")]
        lines += [_claim(name, values) for name, values in CLAIMED.items()]
        lines += [_row(name, group, system) for name, group in _grouped(found).items()]
        lines.append("")
    return "\n".join(lines)


def plain_text(found: Sequence[dict[str, Any]]) -> str:
    """One row per variant."""
    rows = [_row(name, group, "standardised") for name, group in _grouped(found).items()]
    return "\n".join([*_head("model", "CPU s"), *rows, ""])


def share_text(found: Sequence[dict[str, Any]]) -> str:
    """One row per variant, one column per share of the data; MSE takeoff / hover."""
    shares = sorted({f["run"]["share"] for f in found}, reverse=True)
    lines = [
        "| MSE, MAE: takeoff / hover | " + " | ".join(f"{100 * s:.0f} %" for s in shares) + " |",
        "|---|" + "---|" * len(shares),
    ]
    for name, group in _grouped(found).items():
        cells = []
        for share in shares:
            here = [f for f in group if f["run"]["share"] == share]
            cells.append("; ".join(_both(here, metric) for metric in ("mse", "mae")))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


TITLES = {
    "standardised": "Standardised: the training residual's spread is 1",
    "physical": "Physical: rad/s, m/s2, gauss, m, m/s, mean over the channels",
    "range": "Range of each phase over all flights is -1..1, as in the published code",
}
PRODUCERS = {
    "table2": (table2, table2_text, "Table II"),
    "folds": (folds, plain_text, "Each flight held out in turn"),
    "ablations": (ablations, share_text, "Ablations"),
    "samples": (samples, share_text, "Small samples"),
    "weights": (weights, plain_text, "Weights of reconstruction / quantiser / distribution"),
}


def _grouped(found: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    groups: dict[str, list[dict[str, Any]]] = {}
    for one in found:
        groups.setdefault(one["run"]["name"], []).append(one)
    return groups


def _head(*names: str) -> list[str]:
    columns = [f"{m} {k}" for m in MODALITIES for k in ("MSE", "MAE", "WD")]
    return [
        f"| {names[0]} | {' | '.join(columns)} | {' | '.join(names[1:])} |",
        "|---|" + "---|" * (len(columns) + len(names) - 1),
    ]


def _claim(name: str, values: Sequence[float]) -> str:
    """The paper's row of one modality, beside whichever of ours it is meant to be."""
    cells = [f"{v:.4f}" for v in values]
    return f"| paper's claim, {name} | {' | '.join(cells * 2)} | 7200 (RTX 3060) |"


def _row(name: str, group: Sequence[dict[str, Any]], system: str) -> str:
    cells = [
        _spread([f["scores"][m][system][k] for f in group]) for m in MODALITIES for k in METRICS
    ]
    seconds = np.mean([f["seconds"] for f in group])
    return f"| {name} (n = {len(group)}) | {' | '.join(cells)} | {seconds:.0f} |"


def _both(group: Sequence[dict[str, Any]], metric: str) -> str:
    return " / ".join(
        f"{np.mean([f['scores'][m]['standardised'][metric] for f in group]):.4f}"
        for m in MODALITIES
    )


def _spread(values: Sequence[float]) -> str:
    """Mean, and standard deviation where there are several."""
    mean = float(np.mean(values))
    digits = 4 if mean >= 1e-3 else 5 if mean >= 1e-4 else 6
    said = f"{mean:.{digits}f}"
    return said if len(values) == 1 else f"{said} ± {np.std(values, ddof=1):.{digits}f}"


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the paper's tables")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--epochs", type=int, help="of every run; default: the preset's")
    parser.add_argument("--seeds", type=int, default=3, help="of the main table and the folds")
    parser.add_argument("--only", action="append", choices=TABLES, help="these tables")
    parser.add_argument("--published", action="store_true", help="also the published code's preset")
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time, one thread each")
    given = parser.parse_args(arguments)
    options = Options(given.epochs, given.seeds, given.published)
    parts = []
    for table in given.only or TABLES:
        runs, text, title = PRODUCERS[table]
        print(f"{title}:", file=sys.stderr)
        parts.append(
            f"## {title}\n\n{text(run_all(given.data, given.out, runs(options), given.jobs))}"
        )
    page = "\n".join(parts)
    (given.out / "paper.md").write_text(page, "utf-8")
    print(page)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
