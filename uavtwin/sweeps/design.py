"""The design of a sweep: the varied factors, their distributions and the values in each run.

    method = "latin_hypercube"
    runs = 1000
    [vary]
    "airframe.mass" = { low = 1.2, high = 1.6 }
    "wind.speed" = { mean = 4.0, sd = 2.0, low = 0.0, high = 12.0 }
    controller = ["lqr", "px4"]

Sources: McKay, Beckman, Conover, Technometrics 21 (1979) for Latin hypercubes; Saltelli et al.,
Computer Physics Communications 181 (2010) 259-270 for the design from which Sobol' indices are
estimated.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc, truncnorm

from twin.component import unknown_name
from twin.errors import TwinError
from twin.vehicle_file.read import toml_tree

Array = NDArray[np.float64]
Value = float | bool | str
"""Value of a factor in one run."""
_FORMS = (
    "{ low = 1.2, high = 1.6 }, with scale = 'log' or steps = 5 where wanted; "
    "{ mean = 1.4, sd = 0.1 }, with low and high where it ends; a list of values; or one value"
)
"""Forms in which a factor may be written, for messages."""


class Distribution(Protocol):
    """Probability distribution of a factor."""

    @property
    def levels(self) -> tuple[Value, ...]:
        """All possible values of a discrete distribution; () for a continuous one."""

    def at(self, share: Array) -> list[Value]:
        """Quantiles: values at cumulative probabilities `share`, shape (n,), each within 0..1."""


_LARGEST, _SHOWN = 1e100, 60
"""Largest magnitude of a number in a distribution, and most characters of a text in a message."""


@dataclass(frozen=True, slots=True)
class Uniform:
    """Uniform distribution between two numbers, or log-uniform.

    Attributes:
        low: Lower bound.
        high: Upper bound.
        log: Whether the logarithm is uniform (log-uniform distribution).
    """

    low: float
    high: float
    log: bool = False

    @property
    def levels(self) -> tuple[Value, ...]:
        """Empty: the distribution is continuous."""
        return ()

    def at(self, share: Array) -> list[Value]:
        """Quantiles at cumulative probabilities, shape (n,)."""
        if self.log:
            ratio = math.log(self.high / self.low)
            return list((self.low * np.exp(share * ratio)).tolist())
        return list((self.low + share * (self.high - self.low)).tolist())


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal distribution, truncated to [low, high].

    Attributes:
        mean: Mean before truncation.
        sd: Standard deviation before truncation.
        low: Lower bound.
        high: Upper bound.
    """

    mean: float
    sd: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def levels(self) -> tuple[Value, ...]:
        """Empty: the distribution is continuous."""
        return ()

    def at(self, share: Array) -> list[Value]:
        """Quantiles at cumulative probabilities, shape (n,)."""
        inside = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # finite without truncation, too
        if math.isinf(self.low) and math.isinf(self.high):
            drawn = norm.ppf(inside, self.mean, self.sd)
        else:
            ends = (np.array([self.low, self.high]) - self.mean) / self.sd
            drawn = truncnorm.ppf(inside, *ends, loc=self.mean, scale=self.sd)
        return list(np.asarray(drawn, dtype=np.float64).tolist())


@dataclass(frozen=True, slots=True)
class Choice:
    """Discrete uniform distribution over a list of values.

    Attributes:
        levels: The values, all of one type.
    """

    levels: tuple[Value, ...]

    def at(self, share: Array) -> list[Value]:
        """Quantiles at cumulative probabilities, shape (n,)."""
        count = len(self.levels)
        picked = np.minimum((share * count).astype(np.intp), count - 1)
        return [self.levels[i] for i in picked.tolist()]


def distribution_of(name: str, given: Any, file: str) -> Distribution:
    """Distribution of a factor from its entry in a design.

    Args:
        name: Name of the factor, for messages.
        given: Entry in the design: a table, a list, or a value.
        file: Name of the design file or option, for messages.

    Raises:
        TwinError: The entry is no distribution, or its numbers are invalid.
    """
    where = f"{file}: {name}"
    if isinstance(given, Mapping):
        return _of_table(where, given)
    values = given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    if not values:
        raise TwinError(f"{where}: an empty list. Write {_FORMS}.")
    for value in values:
        wrong = not isinstance(value, bool | int | float | str)
        if wrong or (isinstance(value, int | float) and not _is_finite(value)):
            raise TwinError(f"{where}: {_said(value)} is no value. Write {_FORMS}.")
    alike = tuple(float(v) if type(v) is int else v for v in values)
    if len({type(v) for v in alike}) > 1:
        raise TwinError(f"{where}: {list(values)} are of several kinds: mix none.")
    return Choice(alike)


def _of_table(where: str, given: Mapping[str, Any]) -> Distribution:
    """Distribution from a table `{ low, high }` or `{ mean, sd }`."""
    ends = {"low", "high"} <= given.keys()
    known = {"mean", "sd", "low", "high"} if "mean" in given else {"low", "high", "scale", "steps"}
    if given.keys() - known or not (ends or {"mean", "sd"} <= given.keys()):
        raise TwinError(f"{where}: {', '.join(given)} is no distribution. Write {_FORMS}.")
    numbers = {k: _number(where, k, v) for k, v in given.items() if k not in ("scale", "steps")}
    if ends and not numbers["low"] < numbers["high"]:
        raise TwinError(
            f"{where}: low = {numbers['low']:g}, high = {numbers['high']:g}: low has to be below."
        )
    if "mean" in given:
        if not numbers["sd"] > 0:
            raise TwinError(f"{where}: sd = {numbers['sd']:g}: needs a positive number.")
        return Normal(**numbers)
    if given.get("scale", "linear") not in ("linear", "log"):
        raise TwinError(f"{where}: scale = {given['scale']!r}: linear or log.")
    uniform = Uniform(**numbers, log=given.get("scale") == "log")
    if uniform.log and uniform.low <= 0:
        raise TwinError(f"{where}: low = {uniform.low:g}: a log scale needs positive numbers.")
    if "steps" not in given:
        return uniform
    steps = given["steps"]
    if type(steps) is not int or not 2 <= steps <= 10_000:
        raise TwinError(f"{where}: steps = {steps!r}: needs an integer of 2 to 10000.")
    return Choice(tuple(uniform.at(np.linspace(0.0, 1.0, steps))))


def _number(where: str, key: str, value: Any) -> float:
    """The value as a finite number.

    Raises:
        TwinError: The value is no finite number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not _is_finite(value):
        raise TwinError(f"{where}: {key} = {_said(value)}: needs a finite number below 1e100.")
    return float(value)


def _is_finite(value: float) -> bool:
    """Whether a number is small enough that sums of it stay finite."""
    return -_LARGEST < value < _LARGEST


def _said(value: Any) -> str:
    """A value as text for a message, shortened."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


METHODS = ("latin_hypercube", "sobol", "random", "grid", "saltelli")
"""Sampling methods."""
MOST_RUNS = 1_000_000
"""Maximum number of runs of a sweep."""
MOST_VALUES = 10_000_000
"""Maximum of runs times factors: about 0.5 GB."""
_MOST_BYTES = 1 << 20
"""Maximum size of a design file."""
DEFAULT_RUNS = 100
"""Number of runs where the design gives none."""
_KEYS = ("method", "runs", "seed", "vary")
"""Keys of a design file."""


@dataclass(frozen=True, slots=True)
class Design:
    """Varied factors and the sampling method.

    Attributes:
        vary: Distribution of each factor, by name.
        method: Sampling method, one of `METHODS`.
        runs: Number of runs; None: the number of grid points for a grid, else `DEFAULT_RUNS`.
        seed: Random seed of the points, and of the noise in run 0; run k uses seed + k.
    """

    vary: Mapping[str, Distribution] = field(default_factory=dict)
    method: str = "latin_hypercube"
    runs: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise TwinError(unknown_name("sweep", "method", self.method, METHODS))
        if self.runs is not None and not 1 <= self.runs <= MOST_RUNS:
            raise TwinError(f"runs = {self.runs}: needs an integer of 1 to {MOST_RUNS}.")

    def points(self) -> list[dict[str, Value]]:
        """Values of the factors in each run, in order of runs.

        Raises:
            TwinError: The method does not allow this number of runs, or a continuous factor.
        """
        if self.method == "grid":
            return self._grid()
        runs = DEFAULT_RUNS if self.runs is None else self.runs
        if not self.vary:
            return [{} for _ in range(runs)]
        self._check_values(runs)
        shares = self._shares(runs, len(self.vary))
        columns = [d.at(shares[:, i]) for i, d in enumerate(self.vary.values())]
        return [dict(zip(self.vary, row, strict=True)) for row in zip(*columns, strict=True)]

    def _check_values(self, runs: int) -> None:
        """Refuse a design that would not fit in memory.

        Raises:
            TwinError: The design has more than `MOST_VALUES` values.
        """
        if runs * len(self.vary) > MOST_VALUES:
            raise TwinError(
                f"sweep: {runs} runs of {len(self.vary)} factors; at most {MOST_VALUES} values are "
                f"held in memory. Take fewer runs, or several sweeps with other seeds."
            )

    def _shares(self, runs: int, width: int) -> Array:
        """Sample of the unit hypercube (cumulative probabilities), shape (runs, width)."""
        rng = np.random.default_rng(self.seed)
        if self.method == "random":
            return rng.random((runs, width))
        if self.method == "latin_hypercube":
            return np.asarray(qmc.LatinHypercube(width, rng=rng).random(runs))
        if self.method == "sobol":
            if runs & (runs - 1):
                low = 2 ** math.floor(math.log2(runs))
                raise TwinError(
                    f"sobol with {runs} runs: its points are balanced for powers of 2. Take {low} "
                    f"or {2 * low} runs, or latin_hypercube."
                )
            return _sobol(width, rng, runs)
        return self._saltelli(runs, width, rng)

    def _saltelli(self, runs: int, width: int, rng: np.random.Generator) -> Array:
        """Saltelli's design: A, B, then A with each column replaced by that of B in turn, shape ((2
        + width) n, width)."""
        n, rest = divmod(runs, width + 2)
        if rest or n < 2 or n & (n - 1):
            near = 2 ** max(1, round(math.log2(max(2.0, runs / (width + 2)))))
            raise TwinError(
                f"saltelli with {runs} runs of {width} factors: needs ({width} + 2) times a power "
                f"of 2. Take {(width + 2) * near} runs."
            )
        both = _sobol(2 * width, rng, n)
        a, b = both[:, :width], both[:, width:]
        mixed = [np.where(np.arange(width) == i, b, a) for i in range(width)]
        return np.vstack([a, b, *mixed])

    def _grid(self) -> list[dict[str, Value]]:
        """All combinations of levels; the last factor varies fastest."""
        for name, d in self.vary.items():
            if not d.levels:
                raise TwinError(
                    f"grid: {name} has no steps. Write {{ low = .., high = .., steps = 5 }} or a "
                    f"list of values."
                )
        count = math.prod(len(d.levels) for d in self.vary.values())
        if count > MOST_RUNS:
            raise TwinError(f"grid: {count} combinations, at most {MOST_RUNS} are run.")
        if self.runs is not None and self.runs != count:
            raise TwinError(
                f"grid: {count} combinations, --runs says {self.runs}. Leave it out, or choose "
                f"another method."
            )
        self._check_values(count)
        combinations = product(*(d.levels for d in self.vary.values()))
        return [dict(zip(self.vary, row, strict=True)) for row in combinations]


def _sobol(width: int, rng: np.random.Generator, count: int) -> Array:
    """Scrambled Sobol' points, shape (count, width)."""
    if width > qmc.Sobol.MAXDIM:
        raise TwinError(
            f"sweep: {width} dimensions of Sobol' points, at most {qmc.Sobol.MAXDIM} are known. "
            f"Take latin_hypercube."
        )
    return np.asarray(qmc.Sobol(width, rng=rng).random(count))


def read_design(path: Path) -> Design:
    """Read a design from a TOML file.

    Raises:
        TwinError: The file cannot be read or is invalid; the text names file, key and value.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_MOST_BYTES + 1).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise TwinError(f"{path}: no design: {error}") from error
    if len(text) > _MOST_BYTES:
        raise TwinError(f"{path.name}: a design has at most {_MOST_BYTES} bytes.")
    content = toml_tree(text, path.name)
    for key in content:
        if key not in _KEYS:
            raise TwinError(unknown_name(path.name, "key", key, _KEYS))
    vary = content.get("vary", {})
    if not isinstance(vary, Mapping):
        raise TwinError(f"{path.name}: vary = {vary!r}: is a table, [vary].")
    for key in ("runs", "seed"):
        if key in content and (type(content[key]) is not int or content[key] < 0):
            raise TwinError(f"{path.name}: {key} = {content[key]!r}: needs an integer.")
    return Design(
        {name: distribution_of(name, given, path.name) for name, given in _flat(vary).items()},
        str(content.get("method", "latin_hypercube")),
        content.get("runs"),
        content.get("seed", 0),
    )


_OF_DISTRIBUTION = {"low", "high", "mean", "sd", "scale", "steps"}
"""Keys of a table that describes a distribution."""


def _flat(table: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Flatten nested tables to dotted factor names, `{airframe: {mass: ..}}` to `airframe.mass`."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        deeper = isinstance(value, Mapping) and not value.keys() & _OF_DISTRIBUTION
        flat |= _flat(value, f"{above}{key}.") if deeper and value else {f"{above}{key}": value}
    return flat


def factor_of(text: str) -> tuple[str, Distribution]:
    """A factor from the command line: NAME=LOW:HIGH, NAME=LOW:HIGH:STEPS or NAME=A,B,C.

    Raises:
        TwinError: The text has none of these forms.
    """
    name, equals, values = text.partition("=")
    form = "write NAME=LOW:HIGH, NAME=LOW:HIGH:STEPS or NAME=A,B,C."
    if not (name and equals and values):
        raise TwinError(f"--vary {text}: {form}")
    if ":" not in values:
        return name, distribution_of(name, [_value(v) for v in values.split(",")], "--vary")
    ends = values.split(":")
    try:
        given: dict[str, Any] = {"low": float(ends[0]), "high": float(ends[1])}
        given |= {"steps": int(ends[2])} if len(ends) == 3 else {}
    except ValueError:
        ends = []
    if len(ends) not in (2, 3):
        raise TwinError(f"--vary {text}: {form}")
    return name, distribution_of(name, given, "--vary")


def _value(text: str) -> Value:
    """A number, true, false, or a word, from the command line."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text
