"""Trainings on the paper's tables, each kept as JSON: a run that was cut short goes on.

    OUT/runs/KEY.json  scores of one training    OUT/models/KEY/  a training under way
    OUT/runs/KEY.npy   its corrections of the test flights

A run counts as long as model, preset, role, seed, flights, share of the data and the code that it
goes through are the same. What reconstructs is scored by what it leaves, what draws by its draws;
an autoencoder, which draws by what it learned of reconstructing, by both.
"""

import ast
import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from learning.compute import device_named, one_thread
from learning.data.channels import CHANNELS, GROUPS, PHASE_CODES
from learning.data.flights import ResidualFlight
from learning.evaluation import errors, rms
from learning.model.baselines import fit_baseline
from learning.model.family import Model, TrainingTask
from learning.model.folder import write_json
from learning.model.registry import family_named
from learning.preset import Preset, Protocol
from learning.training.train import fit_model
from twin.errors import LogError, ModelError
from twin.logs.stored import as_log_error, opened
from twin.residuals.gap import spectrum

from .adversarial import Cgan, MrGan, TsGan, Wgan
from .autoencoders import AutoFilterVq, ContrastVq, Cvae, McVq, VqGan, VqVae, VqwwVae
from .diffusing import Tdm, TimeDdpm
from .innovations import InnovationsPreset, fit_recording
from .system import Role, System, SystemPreset, fit_system

Array = NDArray[np.float64]
SYSTEMS: Mapping[str, type[System]] = MappingProxyType(
    {
        **{"cvae": Cvae, "vqvae": VqVae, "wgan": Wgan, "tsgan": TsGan, "vqgan": VqGan},
        **{"cgan": Cgan, "mrgan": MrGan, "vqwwvae": VqwwVae, "tdm": Tdm, "timeddpm": TimeDdpm},
        **{"autofiltervq": AutoFilterVq, "contrastvq": ContrastVq, "mcvq": McVq},
    }
)
"""The thirteen that the paper compares its network with, by name. `cgan`, `mrgan`, `vqwwvae`,
`tdm` and `timeddpm` are made after one line of the paper's each."""
DRAWS = 8
"""Of each generator."""
MODALITIES = ("takeoff", "hover")
UNIT_SYSTEMS = ("standardised", "physical", "range")
"""Units: spread of the training residual = 1; SI but gauss, as published; each phase's range over
all three flights = -1..1, as in the published code."""
METRICS = ("mse", "rmse", "mae", "wasserstein")
DRAWN = ("rmse", "wasserstein", "spectral_db")
ALL = (1, 2, 3)


@dataclass(frozen=True, slots=True)
class Rule:
    """What is fitted without a preset.

    Attributes:
        name: A baseline of `learning.model.baselines`, or `RECORDING`.
    """

    name: str


RECORDING = Rule("recording")
"""A training flight played back."""
Trained = Preset | SystemPreset | InnovationsPreset | Rule
"""Hyper-parameters, whose kind says what is trained."""


@dataclass(frozen=True, slots=True)
class Run:
    """One training and what it is scored on.

    Attributes:
        name: Of the variant, as printed.
        preset: Hyper-parameters; their kind says what is trained.
        seed: Of everything that is drawn.
        train: Numbers of the flights.
        test: Number of the flight scored; 0: the training flights themselves, as published.
        share: Of each phase of each training flight, from its start.
        role: What it is trained for.
        horizon: Samples, in `track`.
    """

    name: str
    preset: Trained
    seed: int = 0
    train: tuple[int, ...] = (1, 2)
    test: int = 3
    share: float = 1.0
    role: Role = "reconstruct"
    horizon: int = 0

    def key(self) -> str:
        """Name of its files: hash of all that decides the scores, code included."""
        decides = [{**asdict(self), "name": ""}, type(self.preset).__name__, self.code()]
        digest = hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()
        name = self.preset.name.replace(" ", "-")
        return f"{name}_{self.role}_{self.seed}_{digest[:12]}"

    def code(self) -> str:
        """Hash of the code that it goes through, comments and docstrings apart."""
        if isinstance(self.preset, SystemPreset):
            return code_hash(SYSTEMS[self.preset.name].__module__)
        of: dict[type, Callable[..., Any]] = {
            Preset: fit_model,
            InnovationsPreset: fit_recording,
            Rule: fit_recording if self.preset == RECORDING else fit_baseline,
        }
        return code_hash(of[type(self.preset)].__module__)


_ROOT = Path(__file__).parents[2]
_OWN = ("learning.", "benchmarks.paper.")
"""Packages whose code decides what is learned."""


@cache
def code_hash(module: str) -> str:
    """Of a module and of all that it imports of `_OWN`; what is said of the code does not count."""
    waiting, trees = [module], dict[str, str]()
    while waiting:
        name = waiting.pop()
        file = _ROOT.joinpath(*name.split(".")).with_suffix(".py")
        if name in trees or not name.startswith(_OWN) or not file.is_file():
            continue
        tree = ast.parse(file.read_text("utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                parts = name.split(".")[: -node.level] if node.level else []
                whole = ".".join([*parts, *filter(None, [node.module])])
                waiting += [whole, *(f"{whole}.{a.name}" for a in node.names)]
            if isinstance(body := getattr(node, "body", None), list):
                node.body = [n for n in body if not _is_text(n)]  # type: ignore[attr-defined]
        trees[name] = ast.dump(tree)
    return hashlib.sha256(json.dumps(trees, sort_keys=True).encode()).hexdigest()[:12]


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def run_all(
    data: Path, out: Path, runs: Sequence[Run], jobs: int = 1, device: str = "cpu"
) -> list[dict[str, Any]]:
    """Scores of every run, in order; those that are there already are not run again.

    Args:
        data: Folder of the paper's tables.
        out: Folder of the results.
        runs: To be done.
        jobs: Trainings at a time.
        device: To train on, as of `learning.compute`; it is no part of what a run is known by.
    """
    distinct = list({r.key(): r for r in runs}.values())
    missing = [r for r in distinct if not _file(out, r).is_file()]
    print(f"{len(distinct)} trainings, {len(missing)} to be done", file=sys.stderr)
    began = time.perf_counter()
    arguments = missing, repeat(data), repeat(out), repeat(device)
    if jobs == 1:
        _follow(map(_score, *arguments), len(missing), began)
    elif missing:
        with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
            _follow(pool.map(_score, *arguments), len(missing), began)
    found = [json.loads(_file(out, r).read_text("utf-8")) for r in runs]
    return [{**f, "run": asdict(r)} for f, r in zip(found, runs, strict=True)]


def said_by(run: Run, out: Path) -> Array:
    """Corrections of the test flights by a run that is done and does not generate, one flight after
    the other, shape (n, 15)."""
    return np.asarray(np.load(_file(out, run).with_suffix(".npy")))


def _follow(each: Any, count: int, began: float) -> None:
    for done, line in enumerate(each, start=1):
        left = (time.perf_counter() - began) / done * (count - done)
        print(f"{done}/{count} {line}; {left:.0f} s left", file=sys.stderr, flush=True)


def shortened(flight: ResidualFlight, share: float) -> ResidualFlight:
    """The first part of each span only."""
    spans = tuple((a, a + round(share * (b - a))) for a, b in flight.spans)
    fresh = np.zeros_like(flight.fresh)
    for a, b in spans:
        fresh[a:b] = flight.fresh[a:b]
    return replace(flight, spans=spans, fresh=fresh)


def scores(
    corrections: Sequence[Array],
    tests: Sequence[ResidualFlight],
    trained: Sequence[ResidualFlight],
    everything: Sequence[ResidualFlight],
) -> dict[str, dict[str, dict[str, float]]]:
    """Modality -> units -> metric, each the mean over the 15 channels.

    Args:
        corrections: One per test flight, shape (n, 15).
        tests: Flights scored.
        trained: They give the standardised unit.
        everything: All flights: they give the range.
    """
    return {
        name: {
            system: _means(residual / unit, said / unit)
            for system, unit in units(name, trained, everything).items()
        }
        for name, residual, said in _by_modality(corrections, tests)
    }


def drawn_scores(
    draws: Sequence[Sequence[Array]],
    tests: Sequence[ResidualFlight],
    trained: Sequence[ResidualFlight],
    everything: Sequence[ResidualFlight],
) -> dict[str, dict[str, dict[str, float]]]:
    """Modality -> units -> metric, each the mean over the 15 channels.

    `rmse` is that of the mean of all draws; `wasserstein` and `spectral_db`, the distance of the
    spectra, are means over the draws.

    Args:
        draws: One per seed and test flight, shape (n, 15).
        tests: Flights they are compared with.
        trained: As of `scores`.
        everything: As of `scores`.
    """
    found: dict[str, dict[str, dict[str, float]]] = {}
    parts = [list(_by_modality(one, tests)) for one in draws]
    for name, residual, middle in _by_modality(np.mean(draws, axis=0), tests):
        own = [said for part in parts for n, _, said in part if n == name]
        t_s = np.arange(len(residual)) / tests[0].rate_hz
        spectral = [
            log_spectral_distance(t_s, r, s)
            for said in own
            for r, s in zip(residual.T, said.T, strict=True)
        ]
        found[name] = {
            system: {
                "rmse": _means(residual / u, middle / u)["rmse"],
                "wasserstein": float(
                    np.mean([_means(residual / u, said / u)["wasserstein"] for said in own])
                ),
                "spectral_db": float(np.nanmean(spectral)),
            }
            for system, u in units(name, trained, everything).items()
        }
    return found


def units(
    modality: str, trained: Sequence[ResidualFlight], everything: Sequence[ResidualFlight]
) -> dict[str, Array]:
    """Sizes of the residual's units in `UNIT_SYSTEMS`, shape (15,) each; `scores` says of what."""
    spread = np.concatenate([f.residual[f.fresh.all(1)] for f in trained]).std(axis=0)
    gauss = np.ones_like(spread)
    gauss[GROUPS["mag"]] = GAUSS_T
    code = PHASE_CODES[modality]
    pooled = np.concatenate([f.residual[f.phase == code] for f in everything])
    return dict(zip(UNIT_SYSTEMS, (spread, gauss, np.ptp(pooled, axis=0) / 2), strict=True))


def rows_of(flight: ResidualFlight, modality: str) -> NDArray[np.bool_]:
    """Its samples of a modality, shape (n,)."""
    return np.asarray(flight.phase == PHASE_CODES[modality])


def _by_modality(
    said: Sequence[Array], tests: Sequence[ResidualFlight]
) -> Iterator[tuple[str, Array, Array]]:
    """Name, residual and what was said of it, of all flights together."""
    for name in MODALITIES:
        rows = [rows_of(f, name) for f in tests]
        residual = np.concatenate([f.residual[r] for f, r in zip(tests, rows, strict=True)])
        yield name, residual, np.concatenate([s[r] for s, r in zip(said, rows, strict=True)])


def _means(residual: Array, said: Array) -> dict[str, float]:
    each = [errors(r, s) for r, s in zip(residual.T, said.T, strict=True)]
    return {name: float(np.mean([one[name] for one in each])) for name in METRICS}


def log_spectral_distance(t_s: Array, measured: Array, simulated: Array) -> float:
    """Root mean square difference of two power spectra, dB; NaN for less than 16 samples.

    Frequencies at which either has no power to rounding are left out.

    Source: Gray & Markel, IEEE Trans. ASSP 24 (1976), 380.
    """
    a, b = (spectrum(t_s, v).psd[1:] for v in (measured, simulated))
    if not len(a):
        return float("nan")
    known = (a > 1e-12 * a.max()) & (b > 1e-12 * b.max()) if a.max() > 0 and b.max() > 0 else a < 0
    if not known.any():
        return float("nan")
    return rms(10 * np.log10(a[known] / b[known]))


@one_thread()
def _score(run: Run, data: Path, out: Path, device: str) -> str:
    """Train, score, keep the scores; returns a line to print."""
    flights = dict(zip(ALL, paper_flights(data, ALL), strict=True))
    trained = [shortened(flights[k], run.share) for k in run.train]
    folder = out / "models" / run.key()
    folder.mkdir(parents=True, exist_ok=True)
    # of one thread: its wall clock on a quiet machine
    where = device_named(device).type
    clock = time.process_time if where == "cpu" else time.perf_counter
    began = clock()
    model = fitted(run, trained, folder, device)
    seconds = clock() - began
    tests = trained if run.test == 0 else [flights[run.test]]
    every = list(flights.values())
    content: dict[str, Any] = {
        "run": asdict(run),
        "device": where,
        "seconds": seconds,
        "weights": _weights(model),
    }
    shown = []
    if run.role != "generate":
        began = time.process_time()
        corrections = [model.run(f).correction for f in tests]
        samples = sum(len(c) for c in corrections)
        content["ms_per_sample"] = 1e3 * (time.process_time() - began) / samples
        content["scores"] = scores(corrections, tests, trained, every)
        np.save(_file(out, run).with_suffix(".npy"), np.concatenate(corrections))
        shown.append(_shown(content["scores"], METRICS))
    if (seeded := _seeded(model)) is not None:
        draws = [[seeded(k).run(f).correction for f in tests] for k in range(DRAWS)]
        content["drawn"] = drawn_scores(draws, tests, trained, every)
        shown.append("drawn " + _shown(content["drawn"], DRAWN))
    write_json(_file(out, run), content)
    shutil.rmtree(folder)
    return f"{run.name}, seed {run.seed}: {seconds:.0f} s, {'; '.join(shown)}"


def fitted(run: Run, trained: Sequence[ResidualFlight], folder: Path, device: str = "cpu") -> Model:
    """The model of a run, trained; `folder` exists and is for what is under way."""
    preset = run.preset
    if isinstance(preset, SystemPreset):
        system = SYSTEMS[preset.name]
        return fit_system(system, trained, preset, run.role, folder, run.horizon, run.seed, device)
    if isinstance(preset, InnovationsPreset):
        return preset.fit(trained, run.seed)
    if isinstance(preset, Rule):
        return (
            fit_recording(trained)
            if preset == RECORDING
            else fit_baseline(preset.name, trained, run.horizon)
        )
    task = TrainingTask(cast(Protocol, run.role), run.horizon, run.seed, device=device)
    family = family_named("svq" if preset.network else "linear")
    return fit_model(trained, family, preset, task, folder)


def _seeded(model: Model) -> Callable[[int], Model] | None:
    """What makes a generator of a seed of a model, None where it draws nothing."""
    with_seed: Callable[[int], Model] | None = getattr(model, "with_seed", None)
    try:
        if with_seed is not None:
            with_seed(0)
    except ModelError:  # it was trained for something else
        return None
    return with_seed


def _weights(model: Model) -> int:
    """Numbers of its network that were trained."""
    network: Any = model if hasattr(model, "parameters") else getattr(model, "system", None)
    return 0 if network is None else sum(p.numel() for p in network.parameters())


def _shown(found: dict[str, dict[str, dict[str, float]]], names: Sequence[str]) -> str:
    return " | ".join(
        f"{m} " + " ".join(f"{found[m]['standardised'][k]:.4f}" for k in names) for m in MODALITIES
    )


def _file(out: Path, run: Run) -> Path:
    folder = out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{run.key()}.json"


# ----------------------------------------------------------------------------------------
# The tables that the paper's network was trained on, as residual flights.
#
# One parquet file per phase and flight (`takeoff_flight1`, `hover_flight1`, ...), columns `real_*`
# and `sim_*` side by side: gyro rad/s, acc m/s2, mag gauss, x..z m, vx..vz m/s, PX4 frames.
#
# They hold no time: the authors stretched a real and an unrelated simulated flight by sample index
# to the same length, slow sensors on straight lines to the *next* sample. Whatever is one step
# ahead is flattered by that. For comparison with the paper's Table II, and nothing else.

RATE_HZ = 166.0
"""Nominal: that of the real flights' IMU before they were stretched by index."""
PHASES = ("takeoff", "hover")
FLIGHTS = (1, 2, 3)
GAUSS_T = 1e-4
_STEMS = {"gyro_": "gyro_", "acc_": "acc_", "mag_": "mag_", "pos_": "", "vel_": "v"}


def paper_flights(folder: Path, flights: Sequence[int] = FLIGHTS) -> list[ResidualFlight]:
    """Residuals of the paper's flights, named flight_1, flight_2, ...

    Takeoff and hover are two spans of one flight, one after the other; there are no commands.

    Args:
        folder: Holds `takeoff_flight1.parquet` and so on.
        flights: Their numbers.

    Raises:
        LogError: A file or a column is missing, or a number is not finite.
    """
    return [_flight(folder, number) for number in flights]


def _flight(folder: Path, number: int) -> ResidualFlight:
    tables = [_read(folder / f"{phase}_flight{number}.parquet") for phase in PHASES]
    sizes = [len(real) for real, _ in tables]
    ends = np.cumsum(sizes)
    real, virtual = (np.vstack(part) for part in zip(*tables, strict=True))
    return ResidualFlight(
        name=f"flight_{number}",
        rate_hz=RATE_HZ,
        t_s=np.arange(ends[-1]) / RATE_HZ,
        virtual=virtual,
        residual=real - virtual,
        fresh=np.ones(real.shape, dtype=np.bool_),
        commands=np.zeros((ends[-1], 0)),
        phase=np.repeat(np.array([PHASE_CODES[p] for p in PHASES], dtype=np.intp), sizes),
        spans=tuple((int(e - n), int(e)) for e, n in zip(ends, sizes, strict=True)),
        notes=("stretched by sample index by the paper's authors; the rate is nominal",),
    )


def _read(path: Path) -> tuple[Array, Array]:
    """Real and simulated readings, SI units, shape (n, 15) each."""
    if not path.is_file():
        raise LogError(
            f"{path}: there is no such file. Give the folder with the paper's residual tables, "
            f"takeoff_flight1.parquet and so on."
        )
    with opened(path, path.name) as file, as_log_error(path.name):
        table = file.read().to_pandas()
    found = []
    for side in ("real_", "sim_"):
        columns = [side + _STEMS[c[:-1]] + c[-1] for c in CHANNELS]
        missing = [c for c in columns if c not in table]
        if missing:
            raise LogError(f"{path.name}: no columns {', '.join(missing)}.")
        values = table[columns].to_numpy(dtype=np.float64, copy=True)
        values[:, [c.startswith("mag") for c in CHANNELS]] *= GAUSS_T
        if not np.isfinite(values).all():
            raise LogError(f"{path.name}: a number is not finite; copy the file again.")
        found.append(values)
    return found[0], found[1]
