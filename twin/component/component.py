"""A component of the twin: equations written once in CasADi, with an interface table.

One `Component` is the source of the Python evaluation (one sample or a batch), the C source of a
native FMU, and the Jacobians. Equations have the form

    x(0) = initial(u, p),   dx/dt = derivatives(x, u, p),   y = outputs(x, u, p)

and are integrated by the classical Runge-Kutta method of fourth order (RK4) with the inputs
held over the step, followed by an optional projection (a quaternion back to unit length).

A sampled component also has memory that changes only at the instants t_k = t_0 + k T, k = 0, 1,
...: x(t_k+) = update(x(t_k-), u, p, w_k, d_k). Here w_k are standard normal draws, a function of
seed, component and k (`normal`), and d_k are delayed values of signals(x, u, p). `Run` is the
reference for the order of evaluation.

Rows of the interface table are `Variable`s: names, kinds and ranges, and checks of values.

Noise is counter-based: only the counter is stored, so a rolled-back simulation draws the same
numbers again, and Python and every FMU on every platform draw the same bits: the generator is
integer arithmetic and the transformation to a normal variate uses only + - * / and sqrt.

Source: generator, Salmon, Moraes, Dror & Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11
(Philox4x64-10, as in NumPy); normal quantile, Wichura, Algorithm AS 241, Applied Statistics 37
(1988), PPND16.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from .along import mapped

Causality = Literal["parameter", "input", "output", "local"]


@dataclass(frozen=True, slots=True)
class Enumeration:
    """A type with named values.

    Attributes:
        name: Name of the type.
        items: Name of each value; the values are 0, 1, ...
    """

    name: str
    items: tuple[str, ...]

    @property
    def legend(self) -> str:
        """Codes and their names, as text."""
        return ", ".join(f"{code} {item}" for code, item in enumerate(self.items))


Kind = Literal["real", "integer", "boolean"] | Enumeration
"""Type of a variable's values; all are numbers in computations."""
LARGEST_INTEGER = 2**31 - 1
"""Largest integer of FMI tools with 32 bits."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One row of a component's interface table: a scalar that an FMI tool sees.

    Attributes:
        name: FMI name, dots for structure (`rotor_1.x`).
        causality: Causality in FMI; local: in an FMU only, for solvers.
        unit: SI unit; "1" for a pure number.
        description: Description in one line.
        start: Value before it is set; an output has none.
        minimum: Smallest allowed value (inclusive).
        maximum: Largest allowed value (inclusive).
        fixed: Whether a parameter is fixed after initialisation.
        kind: Type of its values; a Boolean is stored as 0 or 1, an enumeration by its code.
        nominal: Typical magnitude, of a Boolean its usual value; None: that of its start value, or
            of its unit.
    """

    name: str
    causality: Causality
    unit: str
    description: str
    start: float = 0.0
    minimum: float | None = None
    maximum: float | None = None
    fixed: bool = False
    kind: Kind = "real"
    nominal: float | None = None

    @property
    def boolean(self) -> bool:
        """Whether it is a Boolean."""
        return self.kind == "boolean"

    @property
    def real(self) -> bool:
        """Whether it may have any value within its range."""
        return self.kind == "real"

    @property
    def kind_name(self) -> str:
        """The kind as a word."""
        return "enumeration" if isinstance(self.kind, Enumeration) else self.kind

    @property
    def meaning(self) -> str:
        """The description, for an enumeration with its codes."""
        if isinstance(self.kind, Enumeration):
            return f"{self.description}: {self.kind.legend}"
        return self.description

    @property
    def start_text(self) -> str:
        """Start value in printed form."""
        if isinstance(self.kind, Enumeration):
            return self.kind.items[int(self.start)]
        if self.boolean:
            return "true" if self.start else "false"
        return f"{self.start:g}"

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> "Variable":
        """Variable from the result of `dataclasses.asdict`, perhaps by way of JSON."""
        kind = row["kind"]
        if isinstance(kind, Mapping):
            kind = Enumeration(kind["name"], tuple(kind["items"]))
        return cls(**{**row, "kind": kind})


def unknown_name(owner: str, kind: str, name: str, known: Iterable[str]) -> str:
    """Error text for an unknown name, with the nearest known one."""
    known = sorted(known)
    near = get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"Did you mean {near[0]!r}?" if near else f"Known: {', '.join(known)}."
    return f"{owner}: there is no {kind} {name!r}. {hint}"


def check_range(owner: str, variable: Variable, value: float) -> None:
    """Raise `ModelError` if the value is not finite, outside the range or of another kind."""
    low, high = variable.minimum, variable.maximum
    if not np.isfinite(value):
        raise ModelError(f"{owner}: {variable.name} = {value} must be a finite number.")
    if not variable.real and value != int(value):
        raise ModelError(f"{owner}: {variable.name} = {value:g} must be a whole number.")
    if isinstance(variable.kind, Enumeration) and not 0 <= value < len(variable.kind.items):
        raise ModelError(
            f"{owner}: {variable.name} = {value:g} is none of its values: {variable.kind.legend}."
        )
    if (low is not None and value < low) or (high is not None and value > high):
        span = f"[{'-inf' if low is None else low:}, {'inf' if high is None else high}]"
        raise ModelError(
            f"{owner}: {variable.name} = {value:g} {variable.unit} is outside its range {span}."
        )


def check_starts(owner: str, settable: Iterable[Variable], starts: Mapping[str, float]) -> None:
    """Raise `ModelError` if a start value belongs to no variable, or is outside its range."""
    known = {v.name: v for v in settable}
    for name, value in starts.items():
        if name not in known:
            raise ModelError(unknown_name(owner, "parameter or input", name, known))
        check_range(owner, known[name], value)


Array = NDArray[np.float64]
CHANNELS_PER_BLOCK = 4
"""Number of channels per Philox block of four 64-bit words."""

_A = (
    3.3871328727963666080,
    1.3314166789178437745e2,
    1.9715909503065514427e3,
    1.3731693765509461125e4,
    4.5921953931549871457e4,
    6.7265770927008700853e4,
    3.3430575583588128105e4,
    2.5090809287301226727e3,
)
_B = (
    1.0,
    4.2313330701600911252e1,
    6.8718700749205790830e2,
    5.3941960214247511077e3,
    2.1213794301586595867e4,
    3.9307895800092710610e4,
    2.8729085735721942674e4,
    5.2264952788528545610e3,
)
_C = (
    1.42343711074968357734,
    4.63033784615654529590,
    5.76949722146069140550,
    3.64784832476320460504,
    1.27045825245236838258,
    2.41780725177450611770e-1,
    2.27238449892691845833e-2,
    7.74545014278341407640e-4,
)
_D = (
    1.0,
    2.05319162663775882187,
    1.67638483018380384940,
    6.89767334985100004550e-1,
    1.48103976427480074590e-1,
    1.51986665636164571966e-2,
    5.47593808499534494600e-4,
    1.05075007164441684324e-9,
)
_E = (
    6.65790464350110377720,
    5.46378491116411436990,
    1.78482653991729133580,
    2.96560571828504891230e-1,
    2.65321895265761230930e-2,
    1.24266094738807843860e-3,
    2.71155556874348757815e-5,
    2.01033439929228813265e-7,
)
_F = (
    1.0,
    5.99832206555887937690e-1,
    1.36929880922735805310e-1,
    1.48753612908506148525e-2,
    7.86869131145613259100e-4,
    1.84631831751005468180e-5,
    1.42151175831644588870e-7,
    2.04426310338993978564e-15,
)
_LN2 = 0.6931471805599453  # natural logarithm of 2


def normal(seed: int, stream: int, channels: int, first: int, count: int) -> Array:
    """Standard normal draws of a component's channels.

    Args:
        seed: Any integer from 0 to 2^63 - 1.
        stream: Number of the component, below 2^32: components with one seed draw different
            numbers.
        channels: Number of channels of the component.
        first: Counter of the first draw, >= 0.
        count: Draws per channel.

    Returns:
        Draws, shape (count, channels); row i belongs to counter `first + i`.
    """
    blocks = -(-channels // CHANNELS_PER_BLOCK)
    words = [_words(seed, (stream << 32) | block, first, count) for block in range(blocks)]
    return normal_of_bits(np.hstack(words)[:, :channels])


def _words(seed: int, second_key: int, first: int, count: int) -> NDArray[np.uint64]:
    # NumPy increments before it draws, so counter k here is block k + 1 of the generator.
    generator = np.random.Philox(
        key=np.array([seed, second_key], dtype=np.uint64),
        counter=np.array([first, 0, 0, 0], dtype=np.uint64),
    )
    return np.asarray(generator.random_raw(CHANNELS_PER_BLOCK * count), np.uint64).reshape(
        count, CHANNELS_PER_BLOCK
    )


def normal_of_bits(bits: NDArray[np.uint64]) -> Array:
    """Standard normal variates of 64-bit words: the quantile of their upper 52 bits."""
    p = ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    q = p - 0.5
    central = 0.180625 - q * q
    middle = q * _rational(central, _A, _B)
    tail = np.where(q < 0, p, 1.0 - p)
    r = np.sqrt(-_log(tail))
    near = _rational(r - 1.6, _C, _D)
    far = _rational(r - 5.0, _E, _F)
    outer = np.where(r <= 5.0, near, far)
    return np.where(np.abs(q) <= 0.425, middle, np.where(q < 0, -outer, outer))


def _rational(x: Array, above: tuple[float, ...], below: tuple[float, ...]) -> Array:
    return _horner(x, above) / _horner(x, below)


def _horner(x: Array, coefficients: tuple[float, ...]) -> Array:
    value = np.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = value * x + c
    return value


def _log(x: Array) -> Array:
    """Natural logarithm by + - * / only: the platform's own differs in the last bit.

    log(m 2^e) = 2 atanh((m - 1) / (m + 1)) + e log 2 with m in [sqrt(1/2), sqrt(2)).
    """
    m, e = np.frexp(x)
    small = m < 0.7071067811865476
    m, e = np.where(small, 2.0 * m, m), e - small
    s = (m - 1.0) / (m + 1.0)
    series = np.full_like(x, 1.0 / 23.0)
    for k in range(21, 0, -2):
        series = series * (s * s) + 1.0 / k
    return 2.0 * s * series + e * _LN2


@dataclass(frozen=True, slots=True)
class State:
    """A state, integrated by the component or, as memory, changed at its sample instants."""

    name: str
    unit: str
    description: str


@dataclass(frozen=True, slots=True)
class Shortcut:
    """Step, outputs and update without some equations, exact while these would have no effect.

    Attributes:
        holds: `(x, p, h) -> 0 or 1`: whether the shortcut is exact over the next h seconds; h = 0
            for the outputs.
        step: `(x, u, p, h) -> x`, equal to the full step while the shortcut is exact.
        outputs: `(x, u, p) -> y`, equal to the full outputs while the shortcut is exact.
        update: `(x, u, p, w, d) -> x`, equal to the full update while it is exact, h = 0; None: the
            component is not sampled.
        signals: `(x, u, p) -> s`, equal to the full signals while it is exact, h = 0; None: not
            sampled.
        derivatives: `(x, u, p) -> dx/dt`, equal to the full ones while it is exact, h = 0.
    """

    holds: ca.Function = field(repr=False)
    step: ca.Function = field(repr=False)
    outputs: ca.Function = field(repr=False)
    update: ca.Function | None = field(repr=False)
    signals: ca.Function | None = field(repr=False)
    derivatives: ca.Function = field(repr=False)


@dataclass(frozen=True, slots=True)
class DelayLine:
    """Stored values of a signal at its last sample instants.

    Attributes:
        samples: Number of stored values, including the present one: the longest delay is samples -
            1 periods.
    """

    name: str
    samples: int


@dataclass(frozen=True, slots=True)
class Sampling:
    """Evaluation at sample instants: signals enter the delay lines, then the update follows.

    Attributes:
        period: Name of the parameter that holds T, s.
        seed: Name of the parameter with the seed of the noise; None without noise.
        channels: Number of standard normal draws per instant.
        sizes: `p -> sd`, standard deviation of each channel; a channel with 0 is not drawn, its
            value is 0.
        stream: Number that separates the draws of this component from those of others with the same
            seed.
        lines: Delay lines.
        signals: `(x, u, p) -> s`, input of each line.
        delays: `p -> s`, delay of each line.
        update: `(x, u, p, w, d) -> x` with the delayed signals d.
    """

    period: str
    seed: str | None
    channels: int
    sizes: ca.Function = field(repr=False)
    stream: int
    lines: tuple[DelayLine, ...] = field(repr=False)
    signals: ca.Function = field(repr=False)
    delays: ca.Function = field(repr=False)
    update: ca.Function = field(repr=False)


@dataclass(frozen=True, slots=True)
class Continuous:
    """Functions for an external solver with variable steps, as in model exchange.

    Attributes:
        states: Indices of the integrated states among all; the others are memory.
        project: `x -> x`, projection onto valid states, such as a quaternion's unit length.
        crossings: `(x, u, p) -> z`: the derivatives may be discontinuous where one of these changes
            sign.
        crossing_names: Name, unit and description of each.
        rests: `p -> 0 or 1`: whether sample instants have no effect.
    """

    states: tuple[int, ...]
    project: ca.Function = field(repr=False)
    crossings: ca.Function = field(repr=False)
    crossing_names: tuple[tuple[str, str, str], ...] = field(repr=False)
    rests: ca.Function = field(repr=False)


@dataclass(frozen=True)
class Component:
    """Equations and interface table, made by `component_builder.ComponentBuilder`.

    Attributes:
        initial: `(u, p) -> x`.
        derivatives: `(x, u, p) -> dx/dt`.
        step: `(x, u, p, h) -> x`, one RK4 step of h seconds, projection included.
        outputs: `(x, u, p) -> y`.
        sampling: Evaluation at sample instants; None: there are none.
        shortcuts: Cheaper functions with equal results, tried in this order.
        max_step_s: Longest RK4 step; longer communication steps are divided into equal parts.
        continuous: Functions for solvers with variable steps; None: omitted.

    The CasADi functions take columns; a matrix with one column per sample is a batch.
    """

    name: str
    description: str
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    output_variables: tuple[Variable, ...]
    states: tuple[State, ...]
    initial: ca.Function
    derivatives: ca.Function
    step: ca.Function
    outputs: ca.Function
    max_step_s: float
    shortcuts: tuple[Shortcut, ...] = ()
    sampling: Sampling | None = None
    continuous: Continuous | None = None

    @property
    def for_solvers(self) -> bool:
        """Whether an external solver may integrate it: discontinuities of its derivatives are
        declared."""
        return self.continuous is not None and bool(self.continuous.crossing_names)

    def __repr__(self) -> str:
        sizes = {
            "parameters": self.parameters,
            "inputs": self.inputs,
            "outputs": self.output_variables,
            "states": self.states,
        }
        counts = ", ".join(f"{len(rows)} {what}" for what, rows in sizes.items())
        return f"Component({self.name!r}, {counts})"

    @property
    def variables(self) -> tuple[Variable, ...]:
        """Interface table in value-reference order: parameters, inputs, outputs."""
        return self.parameters + self.inputs + self.output_variables

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(v.name for v in self.inputs)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""
        return tuple(v.name for v in self.output_variables)

    def parameter_values(self, changes: Mapping[str, float] | None = None) -> Array:
        """Start values of the parameters, with changes; shape (n_p,).

        Raises:
            ModelError: A name is not a parameter, or a value is outside its range.
        """
        return _values(self.name, self.parameters, changes or {})

    def input_values(self, changes: Mapping[str, float] | None = None) -> Array:
        """Start values of the inputs, with changes; shape (n_u,)."""
        return _values(self.name, self.inputs, changes or {})

    def outputs_along(
        self, states: Array, inputs: Array, changes: Mapping[str, float] | None = None
    ) -> Array:
        """Outputs at each of n rows, shape (n, n_y).

        Args:
            states: States, shape (n, n_x).
            inputs: Inputs, shape (n, n_u).
            changes: Parameters that differ from their start values.
        """
        p = self.parameter_values(changes)
        return mapped(self.outputs, states, inputs, np.broadcast_to(p, (len(states), len(p))))

    def with_starts(self, starts: Mapping[str, float]) -> "Component":
        """The component with other start values of parameters or inputs.

        Raises:
            ModelError: A name is neither, or a value is outside its range.
        """
        check_starts(self.name, self.parameters + self.inputs, starts)
        return replace(
            self,
            parameters=tuple(
                replace(v, start=starts.get(v.name, v.start)) for v in self.parameters
            ),
            inputs=tuple(replace(v, start=starts.get(v.name, v.start)) for v in self.inputs),
        )

    def advance(self, x: Array, u: Array, p: Array, duration_s: float) -> Array:
        """Integrate over one communication step exactly as the FMU does; shape (n_x,)."""
        n, h = substeps(duration_s, self.max_step_s)
        for _ in range(n):
            x = np.asarray(self.step(x, u, p, h), dtype=np.float64).ravel()
        return x


class Run:
    """One simulation of a component in Python, equal step by step to its FMU.

    Attributes:
        x: State, shape (n_x,).
    """

    def __init__(self, component: Component, u: Array, p: Array, time_s: float = 0.0) -> None:
        self.component, self.p = component, p
        self.x = np.asarray(component.initial(u, p), dtype=np.float64).ravel()
        self._start_s, self._count = time_s, 0
        lines = () if component.sampling is None else component.sampling.lines
        self._records = tuple(np.zeros(line.samples) for line in lines)
        self._sample(u)

    def step(self, time_s: float, step_s: float, u: Array) -> None:
        """One communication step from a given time, with the inputs held."""
        sampling, left_s = self.component.sampling, step_s
        if sampling is None:
            self.x = self.component.advance(self.x, u, self.p, step_s)
            return
        period_s = self._parameter(sampling.period)
        slack_s = SAMPLE_TOLERANCE * period_s
        now_s = time_s
        while True:
            ahead_s = self._start_s + (self._count + 1) * period_s - now_s
            due = ahead_s <= left_s + slack_s
            part_s = ahead_s if due and ahead_s < left_s - slack_s else left_s
            if part_s > slack_s:
                self.x = self.component.advance(self.x, u, self.p, part_s)
            now_s, left_s = now_s + part_s, left_s - part_s
            if not due:
                break
            self._count += 1
            self._sample(u)

    def outputs(self, u: Array) -> Array:
        """Present outputs, shape (n_y,)."""
        return np.asarray(self.component.outputs(self.x, u, self.p), dtype=np.float64).ravel()

    def saved(self) -> Array:
        """The complete state of the run as one array, from which `restored` continues exactly."""
        return np.concatenate([[self._start_s, self._count], self.x, *self._records])

    @classmethod
    def restored(cls, component: Component, p: Array, saved: Array) -> "Run":
        """The run of a component with these parameters from the result of `saved`."""
        run = cls.__new__(cls)
        run.component, run.p = component, p
        (start_s, count), run.x, *records = np.split(saved, np.cumsum(cls._sizes(component))[:-1])
        run._start_s, run._count, run._records = float(start_s), int(count), tuple(records)
        return run

    @staticmethod
    def saved_size(component: Component) -> int:
        """Length of the result of `saved`."""
        return sum(Run._sizes(component))

    @staticmethod
    def _sizes(component: Component) -> list[int]:
        lines = component.sampling.lines if component.sampling else ()
        return [2, len(component.states), *(line.samples for line in lines)]

    def _sample(self, u: Array) -> None:
        sampling = self.component.sampling
        if sampling is None:
            return
        w = np.zeros(0)
        if sampling.seed is not None:
            seed = int(self._parameter(sampling.seed))
            w = normal(seed, sampling.stream, sampling.channels, self._count, 1)[0]
            w[np.asarray(sampling.sizes(self.p)).ravel() == 0] = 0.0
        d = self._look_back(sampling, u)
        self.x = np.asarray(sampling.update(self.x, u, self.p, w, d), dtype=np.float64).ravel()

    def _look_back(self, sampling: Sampling, u: Array) -> Array:
        """Store the signals of this instant and return each with its delay.

        Sample j of a line is at j modulo its length; before the first one a signal is constant.
        """
        signals = np.asarray(sampling.signals(self.x, u, self.p), dtype=np.float64).ravel()
        delays_s = np.asarray(sampling.delays(self.p), dtype=np.float64).ravel()
        period_s, k = self._parameter(sampling.period), self._count
        records, delayed = [], []
        for line, record, signal, delay_s in zip(
            sampling.lines, self._records, signals, delays_s, strict=True
        ):
            n = line.samples
            periods = float(delay_s) / period_s
            if not 0 <= periods <= n - 1 + SAMPLE_TOLERANCE:
                raise ModelError(
                    f"{self.component.name}: delay {line.name} = {delay_s:g} s must be from 0 to "
                    f"{(n - 1) * period_s:g} s: make it shorter or {sampling.period} longer."
                )
            periods = min(periods, n - 1.0)
            back = int(periods)
            record = record.copy()  # a copy of the run needs its own
            record[k % n] = signal
            after, before = (record[max(k - j, 0) % n] for j in (back, back + 1))
            delayed.append(after + (periods - back) * (before - after))
            records.append(record)
        self._records = tuple(records)
        return np.array(delayed)

    def _parameter(self, name: str) -> float:
        names = [v.name for v in self.component.parameters]
        return float(self.p[names.index(name)])


SAMPLE_TOLERANCE = 1e-6
"""Distance of a sample instant from the end of a step, in periods, below which it is at the end:
communication points have rounding errors."""


def substeps(duration_s: float, max_step_s: float) -> tuple[int, float]:
    """Number and length of the equal RK4 steps in one communication step."""
    n = max(1, int(np.ceil(duration_s / max_step_s - 1e-6)))
    return n, duration_s / n


def _values(owner: str, table: tuple[Variable, ...], changes: Mapping[str, float]) -> Array:
    by_name = {v.name: v for v in table}
    for name, value in changes.items():
        if name not in by_name:
            kind = table[0].causality if table else "variable"
            raise ModelError(unknown_name(owner, kind, name, by_name))
        check_range(owner, by_name[name], value)
    return np.array([changes.get(v.name, v.start) for v in table], dtype=np.float64)
