"""What the paper's tables are made of: the runs of each, and their scores as rows that are kept."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from learning.model.baselines import RULES
from learning.preset import BEST, LINEAR, PAPER, PUBLISHED, SEEDS, Preset

from .innovations import INNOVATIONS
from .system import Role, SystemPreset, roles
from .trainings import ALL, RECORDING, SYSTEMS, Rule, Run, Trained, said_by

Array = NDArray[np.float64]
P = TypeVar("P", Preset, SystemPreset)
TRIVIAL = {"none": "zero", "mean": "mean of the phase", "average": "moving average"}
"""Rows of baselines in `reconstruct`, by rule."""
NEEDED: dict[str, tuple[Role, int]] = {"track 10": ("track", 10), "free": ("free", 0)}
"""Roles in which a compensator is of use, by their columns."""
NEEDED_EPOCHS = 50
"""Of that table."""
ABLATION_EPOCHS = 12
"""Of the table with many variants: it ranks them."""
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

    def shortened(self, preset: P) -> P:
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
        runs += [r for name in SYSTEMS for r in _compared(name, options, share)]
        runs += [Run(name, Rule(rule), share=share) for rule, name in TRIVIAL.items()]
        drawn: dict[str, Trained] = {**INNOVATIONS, RECORDED: RECORDING}
        runs += [Run(name, p, share=share, role="generate") for name, p in drawn.items()]
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
    preset = options.shortened(SystemPreset(name))
    roles: list[Role] = ["reconstruct"]
    if not SYSTEMS[name].autoencoder:
        roles.append("generate")
    return [
        Run(name, preset, PAPER_SEED + k, share=share, role=role)
        for role in roles
        for k in range(options.seeds)
    ]


def needed(options: Options) -> list[Run]:
    """Every system and baseline where the answer is not given: an old residual is seen, or none."""
    options = options if options.epochs else replace(options, epochs=NEEDED_EPOCHS)
    runs = []
    for role, horizon in NEEDED.values():
        rules = [n for n, rule in RULES.items() if role in rule.protocols]
        systems = [n for n, system in SYSTEMS.items() if role in roles(system)]
        presets: dict[str, Trained] = {
            **{p.name: options.shortened(p) for p in (BEST, LINEAR)},
            **{n: Rule(n) for n in rules},
            **{n: options.shortened(SystemPreset(n)) for n in systems},
        }
        runs += [
            Run(n, preset, PAPER_SEED, role=role, horizon=horizon) for n, preset in presets.items()
        ]
    return runs


def ablations(options: Options) -> list[Run]:
    """One switch turned, with less and less data."""
    options = options if options.epochs else replace(options, epochs=ABLATION_EPOCHS)
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


def vae(options: Options) -> list[Run]:
    """Weights of the whole of L_VAE, in short trainings; the preset as it is stands first."""
    options = options if options.epochs else replace(options, epochs=ABLATION_EPOCHS)
    return [
        Run(f"{preset.name}{what}", options.shortened(one), SEEDS.get(preset.name, 0))
        for preset in (PAPER, BEST)
        for what, one in {
            "": preset,
            **{f", gamma_VAE {w:g}": _of_vae(preset, w) for w in WEIGHTS},
        }.items()
    ]


def weights(options: Options) -> list[Run]:
    """Weights of the losses, one changed at a time; the preset as it is stands first."""
    runs = []
    for preset in (PAPER, BEST):
        turned = {"": preset}
        turned |= {f", gamma_vq {w:g}": replace(preset, weight_quantiser=w) for w in WEIGHTS}
        turned |= {f", gamma_VAE {w:g}": _of_vae(preset, w) for w in WEIGHTS}
        turned |= {f", distribution {w:g}": replace(preset, weight_distribution=w) for w in WEIGHTS}
        runs += [
            Run(preset.name + what, options.shortened(one), seed)
            for what, one in turned.items()
            for seed in _seeds(preset, options)
        ]
    return runs


def _of_vae(preset: Preset, weight: float) -> Preset:
    """A weight on the whole of L_VAE, reconstruction and distribution (Eqs. 13 to 15)."""
    return replace(
        preset,
        weight_reconstruction=weight * preset.weight_reconstruction,
        weight_distribution=weight * preset.weight_distribution,
    )


def _seeds(preset: Preset, options: Options) -> range:
    """The preset's own, and those that follow."""
    first, count = SEEDS.get(preset.name, 0), options.seeds
    if preset.name == PAPER.name and options.seeds_paper is not None:
        count = options.seeds_paper
    return range(first, first + count)


TABLES: dict[str, Callable[[Options], list[Run]]] = {
    "II": table2,
    "III": samples,
    "V": weights,
    "gamma_VAE": vae,
    "needed": needed,
    "ablations": ablations,
    "published": published,
}
"""Runs of each table."""
SCORES = Path(__file__).parents[2] / "docs" / "results" / "paper_scores.jsonl"
"""Of every row of the tables, with the commit that scored it: what the pages are printed from."""
IDENTITY = ("table", "row", "role", "share")
"""What tells rows apart."""
Row = dict[str, Any]


def rows_of(table: str, found: Sequence[dict[str, Any]], commit: str) -> list[Row]:
    """Runs as rows: mean over the seeds, and standard deviation where there are several.

    Args:
        table: Of `TABLES`.
        found: Of `trainings.run_all`.
        commit: Of the code that scored them.
    """
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for one in found:
        run = one["run"]
        groups.setdefault((run["name"], run["role"], run["share"]), []).append(one)
    return [
        {
            **dict(zip(IDENTITY, (table, *key), strict=True)),
            "n": len(group),
            "commit": commit,
            "weights": group[0]["weights"],
            **{
                name: float(f"{np.mean([g[name] for g in group]):.6g}")
                for name in ("seconds", "ms_per_sample")
                if name in group[0]
            },
            **{k: pooled([g[k] for g in group]) for k in ("scores", "drawn") if k in group[0]},
        }
        for key, group in groups.items()
    ]


def pooled(values: Sequence[Any]) -> Any:
    """[mean, standard deviation or None] of each number in dicts that are alike."""
    if isinstance(values[0], dict):
        return {k: pooled([v[k] for v in values]) for k in values[0]}
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return [float(f"{np.mean(values):.6g}"), spread and float(f"{spread:.3g}")]


def read_rows(file: Path = SCORES) -> list[Row]:
    """All rows, in order."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]


def write_rows(rows: Sequence[Row], file: Path = SCORES) -> None:
    """Replace rows of the same identity, and add the others."""
    kept = read_rows(file) if file.is_file() else []
    found = {tuple(r.get(k) for k in IDENTITY): r for r in (*kept, *rows)}
    text = "".join(f"{json.dumps(r)}\n" for r in found.values())
    file.write_text(text, "utf-8")


def corrections(runs: Sequence[Run], out: Path, role: Role = "reconstruct") -> dict[str, Array]:
    """What each row that was trained on everything said of flight 3, by its name, shape (n, 15).

    Args:
        runs: Done ones; the first of a name counts.
        out: As of `trainings.run_all`.
        role: For which they were trained.
    """
    found: dict[str, Array] = {}
    for run in runs:
        if run.share == 1 and run.role == role and run.name not in found:
            found[run.name] = said_by(run, out)
    return found
