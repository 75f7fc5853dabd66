"""The paper's tables alongside ours: `python -m benchmarks.paper.comparison --data D --out OUT`.

D holds the paper's residual tables (takeoff_flight1.parquet, ...). Each table names the runs it is
made of; `--epochs` shortens all of them, `--only` picks tables, and a run that is done is not done
again. The tables are printed as Markdown and written to OUT/paper.md.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.model.registry import families, preset_named
from learning.preset import BEST, PAPER, PUBLISHED, SEEDS, Preset, Protocol

from .families import SYSTEMS
from .system import SystemPreset
from .trainings import (
    ALL,
    DRAWN,
    METRICS,
    MODALITIES,
    RECORDING,
    UNIT_SYSTEMS,
    Run,
    run_all,
    said_by,
)

Array = NDArray[np.float64]
CLAIMED = {"modality 1": (0.0012, 0.0165, 0.0137), "modality 2": (0.0047, 0.0315, 0.0231)}
"""The proposed model in Table II: the column headed RMSE, MAE, Wasserstein. The published code
numbers hover 1 and takeoff 2; the paper does not say."""
CLAIMED_S = 7200
"""On an RTX 3060, as the paper has it."""
COMPARED = tuple(row.name for row in SYSTEMS)
"""The thirteen systems of the paper's comparison."""
TRIVIAL = {"none": "zero", "mean": "mean of the phase", "average": "moving average"}
"""Rows of baselines in `reconstruct`, by preset."""
INNOVATIONS = {
    "white-noise": "white noise",
    "ar-gaussian": "autoregression, Gaussian innovations",
    "ar-codebook": "autoregression, codebook of innovations",
}
"""Rows of baselines in `generate`, by preset."""
NEEDED: dict[str, tuple[Protocol, int]] = {"track 10": ("track", 10), "free": ("free", 0)}
"""Protocols in which a compensator is of use, by their columns."""
PAPER_SEED = SEEDS["paper"]
RECORDED = "a training flight played back"
SHARES = {
    "table2": (1.0, 0.5, 0.25),
    "ablations": (1.0, 0.5, 0.25),
    "samples": (1.0, 0.6, 0.3, 0.1),
}
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
    "k-means, two clusters for four": {"clustering": "kmeans", "n_clusters": 2},
}
WEIGHTS = (0.1, 0.5, 0.9)
"""Of the quantiser (gamma_vq), and of the distribution (gamma_VAE), in Table V."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says.

    Attributes:
        epochs: Of every run; None: the preset's.
        seeds: Runs of each row.
        shares: Of the data, in the main table.
        seeds_paper: Runs of each row of the paper's own preset, which takes four times as long as
            others; None: as many.
    """

    epochs: int | None
    seeds: int
    shares: tuple[float, ...] = SHARES["table2"]
    seeds_paper: int | None = None

    def shortened(self, preset: Preset) -> Preset:
        """The preset with the asked number of epochs."""
        return preset if self.epochs is None else replace(preset, epochs=self.epochs)


def table2(options: Options) -> list[Run]:
    """All systems, and trivial ones; trained on flights 1 and 2, tested on 3."""
    rows = {
        "paper": PAPER,
        "best": BEST,
        "best, no quantiser": replace(BEST, quantiser="none"),
    }
    runs = [
        Run(name, options.shortened(preset), seed, share=share)
        for share in options.shares
        for name, preset in rows.items()
        for seed in _seeds(preset, options)
    ]
    for share in options.shares:
        runs += [r for name in COMPARED for r in _compared(name, options, share)]
        runs += [
            Run(name, preset_named(p)[1], share=share, model="trivial")
            for p, name in TRIVIAL.items()
        ]
        runs += [
            Run(name, preset_named(p)[1], share=share, model="innovations", protocol="generate")
            for p, name in INNOVATIONS.items()
        ]
        runs.append(Run(RECORDED, None, share=share, model=RECORDING, protocol="generate"))
    return runs


def published(options: Options) -> list[Run]:
    """The published code's preset on its own terms, scored on what it was trained on, and held out;
    alongside it `best` on the same terms. Its windows begin every 40 samples, not every 4."""
    own, best = replace(options.shortened(PUBLISHED), stride=40), options.shortened(BEST)
    return [
        Run("published, held out", own, SEEDS["published"]),
        Run("best, held out", best),
        Run("published, training windows", own, SEEDS["published"], train=ALL, test=0),
        Run("best, training windows", best, train=ALL, test=0),
    ]


def _compared(name: str, options: Options, share: float) -> list[Run]:
    """A system that reconstructs, and once more that generates where it learns that apart."""
    row, preset = preset_named(name)
    assert isinstance(preset, SystemPreset)
    given = preset if options.epochs is None else replace(preset, epochs=options.epochs)
    protocols: list[Protocol] = ["reconstruct"]
    if not row.load().system.autoencoder:  # type: ignore[attr-defined]
        protocols.append("generate")
    return [
        Run(name, given, PAPER_SEED + k, share=share, model=name, protocol=protocol)
        for protocol in protocols
        for k in range(options.seeds)
    ]


def needed(options: Options) -> list[Run]:
    """Every system and baseline where the answer is not given: an old residual is seen, or none."""
    runs = []
    for family in families():
        presets = family.presets if family.name == "trivial" else (family.usual,)
        for name in presets:
            row, preset = preset_named(name)
            if isinstance(preset, SystemPreset | Preset) and options.epochs is not None:
                preset = replace(preset, epochs=options.epochs)
            runs += [
                Run(name, preset, PAPER_SEED, model=row.name, protocol=protocol, horizon=horizon)
                for protocol, horizon in NEEDED.values()
                if protocol in row.load().protocols(preset)
            ]
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
        Run(preset.name, options.shortened(preset), seed, share=share)
        for preset in (PAPER, BEST)
        for share in SHARES["samples"]
        for seed in _seeds(preset, options)
    ]


def weights(options: Options) -> list[Run]:
    """Weights of the losses, one changed at a time; the preset as it is stands first."""
    runs = []
    for preset in (PAPER, BEST):
        turned = {"": preset}
        turned |= {f", gamma_vq {w:g}": replace(preset, weight_quantiser=w) for w in WEIGHTS}
        turned |= {f", gamma_VAE {w:g}": replace(preset, weight_distribution=w) for w in WEIGHTS}
        runs += [
            Run(preset.name + what, options.shortened(one), seed)
            for what, one in turned.items()
            for seed in _seeds(preset, options)
        ]
    return runs


def _seeds(preset: Preset, options: Options) -> range:
    """The preset's own, and those that follow."""
    first, count = SEEDS.get(preset.name, 0), options.seeds
    if preset.name == PAPER.name and options.seeds_paper is not None:
        count = options.seeds_paper
    return range(first, first + count)


def table2_text(found: Sequence[dict[str, Any]]) -> str:
    """The main table: what each leaves, in every system of units, and what each draws."""
    lines = []
    for share in sorted({f["run"]["share"] for f in found}, reverse=True):
        here = [f for f in found if f["run"]["share"] == share]
        data = "" if share == 1 else f", the first {100 * share:.0f} % of each phase"
        made = _grouped([f for f in here if "scores" in f])
        for system in UNIT_SYSTEMS if share == 1 else UNIT_SYSTEMS[:2]:
            lines += [f"### `reconstruct`{data}. {TITLES[system]}", "", *_head("model", *COSTS)]
            lines += [line for name, v in CLAIMED.items() for line in _claims(name, v)]
            lines += [_row(name, group, system, COSTS) for name, group in made.items()]
            lines.append("")
        drawn = _grouped([f for f in here if "drawn" in f])
        for system in UNIT_SYSTEMS[:2]:
            lines += [f"### `generate`{data}. {TITLES[system]}", "", *_drawn_head()]
            lines += [_drawn_row(name, group, system) for name, group in drawn.items()]
            lines.append("")
    return "\n".join(lines)


def every_unit_text(found: Sequence[dict[str, Any]]) -> str:
    """One row per variant, in every system of units."""
    lines = []
    for system in UNIT_SYSTEMS:
        lines += [f"### {TITLES[system]}", "", *_head("model", *COSTS)]
        lines += [_row(name, group, system, COSTS) for name, group in _grouped(found).items()]
        lines.append("")
    return "\n".join(lines)


def _claims(name: str, values: Sequence[float]) -> Iterator[str]:
    """The paper's row of one modality, its first column read both ways, alongside whichever of ours
    it is meant to be."""
    headed, mae, distance = values
    for what, mse, rmse in (
        ("RMSE read as MSE", headed, np.sqrt(headed)),
        ("RMSE as headed", headed**2, headed),
    ):
        cells = [_digits(float(v)) for v in (mse, rmse, mae, distance)] * 2
        costs = [f"{CLAIMED_S} (RTX 3060)", "", ""]
        yield f"| paper's claim, {name}, {what} | {' | '.join([*cells, *costs])} |"


def _drawn_head() -> list[str]:
    columns = [f"{m} {k}" for m in MODALITIES for k in ("RMSE of mean", "WD", "spectrum, dB")]
    return [f"| model | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]


def _drawn_row(name: str, group: Sequence[dict[str, Any]], system: str) -> str:
    cells = [_spread([f["drawn"][m][system][k] for f in group]) for m in MODALITIES for k in DRAWN]
    return f"| {name} (n = {len(group)}) | {' | '.join(cells)} |"


def needed_text(found: Sequence[dict[str, Any]]) -> str:
    """One row per system, takeoff and hover of each protocol, standardised."""
    columns = [f"{c}, {m}" for c in NEEDED for m in MODALITIES]
    lines = [f"| RMSE | {' | '.join(columns)} | CPU s |", "|---|" + "---|" * (len(columns) + 1)]
    for name, group in _grouped(found).items():
        by_protocol = {f["run"]["protocol"]: f for f in group}
        cells = []
        for protocol, _ in NEEDED.values():
            one = by_protocol.get(protocol)
            cells += [_rmse(one, m) if one else "-" for m in MODALITIES]
        seconds = sum(f["seconds"] for f in group)
        lines.append(f"| {name} | {' | '.join(cells)} | {seconds:.0f} |")
    return "\n".join([*lines, ""])


def _rmse(one: dict[str, Any], modality: str) -> str:
    return _digits(one["scores"][modality]["standardised"]["rmse"])


def plain_text(found: Sequence[dict[str, Any]]) -> str:
    """One row per variant."""
    costs = COSTS[:1]
    rows = [_row(name, group, "standardised", costs) for name, group in _grouped(found).items()]
    return "\n".join([*_head("model", *costs), *rows, ""])


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
        count = len({f["run"]["seed"] for f in group})
        lines.append(f"| {name} (n = {count}) | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


COSTS = ("CPU s", "numbers", "ms a sample")
"""Of training, trained, of whole flights at once; one thread."""
TITLES = {
    "standardised": "Standardised: the training residual's spread is 1",
    "physical": "Physical: rad/s, m/s2, gauss, m, m/s, mean over the channels",
    "range": "Range of each phase over all flights is -1..1, as in the published code",
}
PRODUCERS = {
    "table2": (table2, table2_text, "Table II"),
    "needed": (needed, needed_text, "Where the answer is not given: `track` 10 and `free`"),
    "folds": (folds, plain_text, "Each flight held out in turn"),
    "ablations": (ablations, share_text, "Ablations"),
    "samples": (samples, share_text, "Table III: small samples"),
    "weights": (weights, plain_text, "Table V: weights of the losses"),
    "published": (published, every_unit_text, "The published code's choices"),
}


def _grouped(found: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    groups: dict[str, list[dict[str, Any]]] = {}
    for one in found:
        groups.setdefault(one["run"]["name"], []).append(one)
    return groups


def _head(*names: str) -> list[str]:
    columns = [f"{m} {k}" for m in MODALITIES for k in ("MSE", "RMSE", "MAE", "WD")]
    return [
        f"| {names[0]} | {' | '.join(columns)} | {' | '.join(names[1:])} |",
        "|---|" + "---|" * (len(columns) + len(names) - 1),
    ]


def _row(name: str, group: Sequence[dict[str, Any]], system: str, costs: Sequence[str]) -> str:
    cells = [
        _spread([f["scores"][m][system][k] for f in group]) for m in MODALITIES for k in METRICS
    ]
    said = {
        "CPU s": f"{np.mean([f['seconds'] for f in group]):.0f}",
        "numbers": str(group[0]["weights"]),
        "ms a sample": f"{np.mean([f['ms_per_sample'] for f in group]):.3f}",
    }
    cells += [said[c] for c in costs]
    return f"| {name} (n = {len(group)}) | {' | '.join(cells)} |"


def _both(group: Sequence[dict[str, Any]], metric: str) -> str:
    return " / ".join(
        _spread([f["scores"][m]["standardised"][metric] for f in group]) for m in MODALITIES
    )


def _spread(values: Sequence[float]) -> str:
    """Mean, and standard deviation where there are several."""
    mean = float(np.mean(values))
    if len(values) == 1:
        return _digits(mean)
    return f"{_digits(mean)} ± {np.std(values, ddof=1):.{_places(mean)}f}"


def _digits(value: float) -> str:
    return f"{value:.{_places(value)}f}"


def _places(value: float) -> int:
    """Decimal places at which a value is printed."""
    return 2 if value >= 10 else 4 if value >= 1e-3 else 5 if value >= 1e-4 else 6


def corrections(
    runs: Sequence[Run], out: Path, protocol: Protocol = "reconstruct"
) -> dict[str, Array]:
    """What each row that was trained on everything said of flight 3, by its name, shape (n, 15).

    Args:
        runs: Done ones; the first of a name counts.
        out: As of `run_all`.
        protocol: For which they were trained.
    """
    found: dict[str, Array] = {}
    for run in runs:
        if run.share == 1 and run.protocol == protocol and run.name not in found:
            found[run.name] = said_by(run, out)
    return found


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the paper's tables")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--epochs", type=int, help="of every run; default: the preset's")
    parser.add_argument(
        "--seeds", type=int, default=3, help="of Tables II, III and V and the folds"
    )
    parser.add_argument("--seeds-paper", type=int, help="of the paper's preset; default: as many")
    parser.add_argument("--only", action="append", choices=PRODUCERS, help="these tables")
    parser.add_argument(
        "--share", type=float, action="append", help="of the data, in the main table"
    )
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time, one thread each")
    parser.add_argument(
        "--device", default="cpu", choices=("cpu", "cuda", "auto"), help="to train on"
    )
    given = parser.parse_args(arguments)
    shares = tuple(given.share or SHARES["table2"])
    options = Options(given.epochs, given.seeds, shares, given.seeds_paper)
    parts = []
    for table in given.only or PRODUCERS:
        runs, text, title = PRODUCERS[table]
        print(f"{title}:", file=sys.stderr)
        found = run_all(given.data, given.out, runs(options), given.jobs, given.device)
        parts.append(f"## {title}\n\n{text(found)}")
    page = "\n".join(parts)
    (given.out / "paper.md").write_text(page, "utf-8")
    print(page)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
