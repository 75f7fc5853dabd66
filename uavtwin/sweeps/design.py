"""The design of a sweep: which factors are varied, by which distributions, and their values.

    method = "latin_hypercube"
    runs = 1000
    [vary]
    "airframe.mass" = { low = 1.2, high = 1.6 }
    "wind.speed" = { mean = 4.0, sd = 2.0, low = 0.0, high = 12.0 }
    controller = ["lqr", "px4"]

Sources: McKay, Beckman, Conover, Technometrics 21 (1979) for Latin hypercubes; Saltelli et al.,
Computer Physics Communications 181 (2010) 259-270 for the design that Sobol' indices are read from.
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
"""Of a factor in one run."""
_FORMS = (
    "{ low = 1.2, high = 1.6 }, with scale = 'log' or steps = 5 where wanted; "
    "{ mean = 1.4, sd = 0.1 }, with low and high where it ends; a list of values; or one value"
)
"""How to write a factor, for messages."""


class Distribution(Protocol):
    """How a factor is drawn."""

    @property
    def levels(self) -> tuple[Value, ...]:
        """All of its values, where they can be counted; else none."""

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability, shape (n,), each within 0..1."""


_LARGEST, _SHOWN = 1e100, 60
"""Largest number of a distribution, and characters of a text that a message shows."""


@dataclass(frozen=True, slots=True)
class Uniform:
    """Between two numbers, all alike; or their logarithms.

    Attributes:
        low: Smallest.
        high: Largest.
        log: Whether all magnitudes are alike.
    """

    low: float
    high: float
    log: bool = False

    @property
    def levels(self) -> tuple[Value, ...]:
        """None that can be counted."""
        return ()

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability."""
        if self.log:
            ratio = math.log(self.high / self.low)
            return list((self.low * np.exp(share * ratio)).tolist())
        return list((self.low + share * (self.high - self.low)).tolist())


@dataclass(frozen=True, slots=True)
class Normal:
    """Around a mean, cut off where it ends.

    Attributes:
        mean: Of the whole distribution.
        sd: Of the whole distribution.
        low: Nothing is below.
        high: Nothing is above.
    """

    mean: float
    sd: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def levels(self) -> tuple[Value, ...]:
        """None that can be counted."""
        return ()

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability."""
        inside = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # the ends of a whole one are infinite
        if math.isinf(self.low) and math.isinf(self.high):
            drawn = norm.ppf(inside, self.mean, self.sd)
        else:
            ends = (np.array([self.low, self.high]) - self.mean) / self.sd
            drawn = truncnorm.ppf(inside, *ends, loc=self.mean, scale=self.sd)
        return list(np.asarray(drawn, dtype=np.float64).tolist())


@dataclass(frozen=True, slots=True)
class Choice:
    """One of some values, all alike.

    Attributes:
        levels: The values, of one kind.
    """

    levels: tuple[Value, ...]

    def at(self, share: Array) -> list[Value]:
        """Values at shares of probability."""
        count = len(self.levels)
        picked = np.minimum((share * count).astype(np.intp), count - 1)
        return [self.levels[i] for i in picked.tolist()]


def distribution_of(name: str, given: Any, file: str) -> Distribution:
    """A distribution as a design says it.

    Args:
        name: Of the factor, for messages.
        given: A table, a list, or a value.
        file: Where it stands, for messages.

    Raises:
        TwinError: It is none, or not a possible one.
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
    """`{ low, high }` or `{ mean, sd }`."""
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
    """A finite number.

    Raises:
        TwinError: It is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not _is_finite(value):
        raise TwinError(f"{where}: {key} = {_said(value)}: needs a finite number below 1e100.")
    return float(value)


def _is_finite(value: float) -> bool:
    """Whether a number, however long it is written, leaves sums finite."""
    return -_LARGEST < value < _LARGEST


def _said(value: Any) -> str:
    """A value for a message, cut short."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


METHODS = ("latin_hypercube", "sobol", "random", "grid", "saltelli")
"""How points are chosen."""
MOST_RUNS = 1_000_000
"""Of a sweep."""
MOST_VALUES = 10_000_000
"""Runs times factors: some 0.5 GB."""
_MOST_BYTES = 1 << 20
"""Of a design file."""
DEFAULT_RUNS = 100
"""Where a design names no number."""
_KEYS = ("method", "runs", "seed", "vary")
"""Of a design file."""


@dataclass(frozen=True, slots=True)
class Design:
    """What is varied, and how.

    Attributes:
        vary: Distribution of each factor.
        method: Of `METHODS`.
        runs: How many; None: as many as a grid has points, else `DEFAULT_RUNS`.
        seed: Of the points, and of the noise of run 0; each run has the next one.
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
        """The factors of each run, in order.

        Raises:
            TwinError: The method cannot have so many runs, or a factor of this kind.
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
        """Refuse what would not fit in memory.

        Raises:
            TwinError: It would not.
        """
        if runs * len(self.vary) > MOST_VALUES:
            raise TwinError(
                f"sweep: {runs} runs of {len(self.vary)} factors; at most {MOST_VALUES} values are "
                f"held in memory. Take fewer runs, or several sweeps with other seeds."
            )

    def _shares(self, runs: int, width: int) -> Array:
        """Shares of probability, shape (runs, width)."""
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
        """A, B, then A with each column of B in turn: (2 + width) n rows."""
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
        """All combinations, the last factor fastest."""
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
    """A design from a TOML file.

    Raises:
        TwinError: Not readable, or wrong; the text names file, key and value.
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
"""Keys of a distribution."""


def _flat(table: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Names with dots, written in quotation marks or as tables within tables."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        deeper = isinstance(value, Mapping) and not value.keys() & _OF_DISTRIBUTION
        flat |= _flat(value, f"{above}{key}.") if deeper and value else {f"{above}{key}": value}
    return flat


def factor_of(text: str) -> tuple[str, Distribution]:
    """A factor of the command line: NAME=LOW:HIGH, NAME=LOW:HIGH:STEPS or NAME=A,B,C.

    Raises:
        TwinError: It is none.
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
    """A number, true, false, or a word."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text
