"""Response of the body to the commands of a flight, learned from the flight itself.

Channels j are the specific force along z and the angular accelerations about x, y, z:

    y_j = s_j (sum_i S_ji eta_i g(c_i) - K_j) + d_j w_j + k_j x_j + b_j + e_j

S: signs of the frame. g: thrust by command, marginalised over several curvatures and lags. eta:
remaining share of a rotor's thrust, 1 while it is intact. s_j absorbs mass, inertia, arm, voltage
and thrust map; K_j is the normal sum, so that the offset b_j does not depend on s_j; w_j body
rates, along z the speed along the axis of the rotors, with which their thrust falls (Leishman,
Principles of Helicopter Aerodynamics, 2006, ch. 2.13), d_j their damping; k_j gyroscopic products
(wx^2 + wy^2 for z); e_j as in `noise`. Model errors grow with activity, for all hypotheses alike: a
lively interval has a small weight, so that a crash cannot outvote an onset.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import lfilter

from ..logs.columns import GYRO
from ..logs.samples import interpolated
from ..residuals.measured import Signal
from ..vehicle import GRAVITY_M_S2
from .flight import Airborne, Array, FlightFrame, binned, lift, moment_signs
from .noise import PHI, TEMPER, Law, Places, Whitened

CURVATURES = (0.0, 0.35, 0.7, 1.0, 1.25)
"""Curvatures of thrust by command: linear, square, square above a dead band."""
USUAL_CURVATURE = 0.65
"""Curvature for learning gains and noise."""
LIKELY = 12.0
"""Nats by which a curvature and lag may explain the early part worse than the best."""
LAGS_S = (0.03, 0.08, 0.15)
"""Lags of thrust behind the command, s: small to large rotors."""
CURVES = tuple(product(CURVATURES, LAGS_S))
"""All combinations of curvature and lag."""
TRIED_LAGS_S = (0.0, 0.03, 0.06, 0.1, 0.15)
"""Lags among which that of the normal part is chosen."""
SETTLES_S, ENDS_S = 1.5, 1.0
"""Times after the start and before the end of a part, s, that are not used: ground contact."""
LEARNED_S, LEARNED_SHARE = 8.0, 1 / 3
"""Early part that determines lag and noise: minimum length, and share of the part."""
SEEN_EARLY_S = 0.1
"""Lead of a detected loss of control, s, since rates are smoothed."""
AFTER_LOSS_S = 1.0
"""Time after a loss of control in which the equations remain valid, s."""
FLOOR = np.array([0.02, 0.02, 0.02, 0.01])
"""Least standard deviation of an innovation, m/s^2 and rad/s^2."""
CLIP = 5.0
"""Standard deviations beyond which an innovation gains no further weight."""
LIVELY = 4.0
"""Standard deviations of the reading from its median up to which an interval has full weight."""
SATURATED = 0.97
"""Share of the largest body rate that counts as saturation of the gyroscope, if it is reached
often."""
AT_STOP, AT_STOP_S = 0.95, 1.0
"""Command close to its upper limit, and time for which it has an effect."""
DOUBTFUL = 0.02
"""Weight of an interval at such a limit."""
CARRIED_M = 0.3
"""Height below which the ground may carry the aircraft and an interval has no weight: legs take all
the moment that the controller demands."""
FAST_HZ = 40.0
"""Rate of commands from which unlogged jitter does not hide the gain."""
SURELY = 2.0
"""Standard deviations by which a gain differs significantly."""
LEAST_GAIN = 0.25
"""Smallest gain of roll and pitch over that of gravity at full thrust, 1/m: half the least for
which an onset is weighed, below that of an aircraft with arms of 3 m."""
ORDER_LEAVES, ORDER_EXPLAINS = 50.0, 0.3
"""Nats of roll and pitch that rotors with individual gains explain beyond those in their order, and
least share that the order then explains. In 42 flights with a wrong order it left 78 or more and
explained 0.20 at most, in 119 with the right one 34.5 at most and 0.34 at least."""
ORDER_SHOWN = 5.0
"""Nats that the order must explain where a gain is not clearly positive. The recorded flights of
CrazyPAD, whose rates are derived and in which roll or pitch is at rest, have 7 or more."""
STATE_ORDER = "put their order into [rotors] of a vehicle file, and give that with --since"
"""Remedy for wrongly numbered motors."""
FINE_S = 0.01
"""Interval on which commands pass their lag."""
LIFT_SPREAD, GAIN_SD = 0.1, 1e3
"""Standard deviation of the gain along z over that by the weight; of a gain about which nothing is
known."""


@dataclass(frozen=True, eq=False)
class Body:
    """A part of a flight as data of the regression; times count intervals from its start.

    Attributes:
        frame: Flight with the part.
        start: First place of the grid.
        end: Place behind the last.
        last: Place behind the last possible onset, relative to `start`.
        lost: Whether control is lost at `last`.
        curves: Candidate curvatures of thrust by command, and lags, s.
    """

    frame: FlightFrame
    start: int
    end: int
    last: int
    lost: bool
    curves: tuple[tuple[float, float], ...] = CURVES

    @classmethod
    def of(cls, frame: FlightFrame, part: Airborne) -> "Body":
        """The part without its ends; after a loss of control until an impact."""
        start = part.start + frame.places(SETTLES_S)
        if part.lost is None:
            end = part.end - frame.places(ENDS_S)
            return cls(frame, start, end, end - start, False)
        end = min(part.lost + frame.places(AFTER_LOSS_S), len(frame.t_s) - 1)
        end = end if part.crash is None else min(end, part.crash - 1)
        last = part.lost - start + frame.places(SEEN_EARLY_S) + 1
        return cls(frame, start, end, min(last, end - start - 1), True)

    def __len__(self) -> int:
        return self.end - self.start

    def places(self, seconds: float) -> int:
        """Number of intervals of a length of time."""
        return self.frame.places(seconds)

    @cached_property
    def t_s(self) -> Array:
        """Midpoints of the intervals, s from the start of the log."""
        return self.frame.t_s[self.start : self.end]

    @cached_property
    def signs(self) -> Array:
        """Signs of the rotors' moments, as in `moment_signs`, shape (4, rotors)."""
        layout = self.frame.layout
        assert layout is not None
        return moment_signs(layout)

    @property
    def rotors(self) -> int:
        """Number of rotors."""
        return int(self.signs.shape[1])

    @cached_property
    def learned(self) -> slice:
        """Slice of the early part."""
        least = min(self.places(LEARNED_S), len(self))
        return slice(0, max(least, int(len(self) * LEARNED_SHARE)))

    @cached_property
    def measured(self) -> Array:
        """The channels, shape (n, 4): m/s^2, rad/s^2."""
        grid = self.frame.grid
        turning = np.gradient(grid["gyro"], self.frame.dt_s, axis=0)
        return np.column_stack([grid["acc"][:, 2], turning])[self.start : self.end]

    @cached_property
    def _rates(self) -> tuple[Array, Array]:
        """Damping and gyroscopic regressors of each channel, shape (n, 4) each."""
        grid, part = self.frame.grid, slice(self.start, self.end)
        w, along = grid["gyro"][part], np.zeros(len(self))
        if "vel" in grid and "q" in grid:
            along = np.einsum("ti,ti->t", self.frame.attitude[part, :, 2], grid["vel"][part])
        x, y, z = w.T
        damping = np.column_stack([along, w])
        return damping, np.column_stack([x**2 + y**2, y * z, x * z, x * y])

    @cached_property
    def _seen(self) -> Array:
        """Weight: 1, less where the gyroscope is saturated, shape (n, 4)."""
        raw, w = np.abs(self.frame.signals["gyro"].values), np.abs(self.frame.grid["gyro"])
        top = raw.max(axis=0)
        stop = (w > SATURATED * top) & ((raw > 0.999 * top).sum(axis=0) > 20)
        stop = stop | np.roll(stop, 1, axis=0) | np.roll(stop, -1, axis=0)
        share = np.where(stop.any(axis=1), 0.3, 1.0)
        return np.column_stack([np.ones(len(w)), ~stop * share[:, None]])[self.start : self.end]

    @cached_property
    def limited(self) -> NDArray[np.bool_]:
        """Whether a command was at its upper limit in the second before, shape (n,): there the
        battery limits the thrust of a rotor, and thrust by command differs from that before."""
        top = self.frame.grid[self.frame.drive or ""].max(axis=1) > AT_STOP
        back = self.places(AT_STOP_S)
        since = uniform_filter1d(top.astype(float), back, origin=(back - 1) // 2)
        return np.asarray(since > 1e-9)[self.start : self.end]

    @cached_property
    def low(self) -> NDArray[np.bool_]:
        """Whether the height is so low that the ground may carry the aircraft, shape (n,)."""
        return np.asarray(self.frame.above_ground_m[self.start : self.end] < CARRIED_M)

    def thrust(self, curvature: float, lag_s: float) -> Array:
        """Thrust of each rotor over that at full command, shape (n, rotors)."""
        drive = self.frame.signals[self.frame.drive or ""]
        edges = self.frame.edges_s[self.start : self.end + 1]
        fine = np.arange(edges[0] - 1.0, edges[-1], FINE_S)
        raised = lift(drive.values, curvature)
        values = interpolated(fine, drive.t_s, raised)
        if lag_s > 0:
            k = 1 - np.exp(-FINE_S / lag_s)
            values = lfilter([k], [1, k - 1], values - values[0], axis=0) + values[0]
        return binned(Signal(fine, np.asarray(values)), edges)

    @cached_property
    def lag_s(self) -> float:
        """Lag of the early part: the one with the least median innovation."""
        cost = {}
        for lag in TRIED_LAGS_S:
            g, total = self.thrust(USUAL_CURVATURE, lag), 0.0
            for j in range(4):
                X = np.diff(self._regressors(g, j)[self.learned], axis=0)
                y = np.diff(self.measured[self.learned, j])
                left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
                total += len(y) * np.log(np.median(np.abs(left)) + 1e-9)
            cost[lag] = total
        return min(cost, key=lambda lag: cost[lag])

    def _regressors(self, thrust: Array, j: int) -> Array:
        return np.column_stack([thrust @ self.signs[j], self._rates[0][:, j], np.ones(len(self))])

    def expected(self) -> Array:
        """Channels expected from the commands, by the early part, shape (n, 4)."""
        g, found = self.thrust(USUAL_CURVATURE, self.lag_s), np.empty((len(self), 4))
        for j in range(4):
            X, early = self._regressors(g, j), self.learned
            found[:, j] = X @ robust_fit(X[early], self.measured[early, j])
        return found

    @cached_property
    def noise(self) -> "Noise":
        """Noise of each channel, by the early part."""
        g = self.thrust(USUAL_CURVATURE, self.lag_s)
        share = (np.where(self.limited, DOUBTFUL, 1.0) * ~self.low)[:, None] * self._seen
        laws, gain, weight = zip(
            *(
                self.noise_of(self._regressors(g, j), self.measured[:, j], FLOOR[j], share[:, j])
                for j in range(4)
            ),
            strict=True,
        )
        return Noise(laws, np.array(gain), np.array(weight))

    def noise_of(
        self,
        regressors: Array,
        y: Array,
        floor: float,
        share: Array,
        phis: Sequence[float] = PHI,
        *,
        swings: bool = True,
    ) -> tuple[Law, float, Array]:
        """Noise law of the residuals in the early part, first number of the regression, and weight
        of each interval.

        Args:
            regressors: Regressors, shape (n, k).
            y: Measured values, shape (n,).
            floor: Least standard deviation of an innovation.
            share: Largest weight of each interval, shape (n,).
            phis: Candidate values of phi.
            swings: Whether an interval is lively by its reading, for channels whose informativeness
                depends on activity; else by its innovation.
        """
        early, law = self.learned, Law(0.8, 0.0, 1.0)
        for _ in range(3):
            beta = robust_fit(law.filtered(regressors[early]), law.filtered(y[early]))
            left = (y - regressors @ beta)[early]
            law = Law.of(left - np.median(left), floor, phis)
        reading = y - np.median(y[early]) if swings else law.filtered(y)
        lively = maximum_filter1d(np.abs(reading), 3)
        excess = np.maximum(lively - LIVELY * law.sd, 0) / CLIP
        return law, float(beta[0]), share * law.sd**2 / (law.sd**2 + excess**2)

    @property
    def fast(self) -> bool:
        """Whether commands are logged fast enough to show the gain."""
        return self.frame.rate_hz(self.frame.drive or "") > FAST_HZ

    @cached_property
    def unanswered(self) -> str:
        """Reason why roll and pitch do not show the effect of a rotor; "": they do, or commands are
        too slow or too constant to decide."""
        layout, part = self.frame.layout, slice(self.start, self.end)
        if not np.ptp(self.frame.grid["gyro"][part], axis=0).any():
            return "the gyroscope stands still"
        if not np.ptp(self.frame.grid[self.frame.drive or ""][part], axis=0).any():
            return "the commands of the rotors never change"
        if self.low.mean() > 0.5:
            return f"it flies lower than {CARRIED_M:g} m, where the ground may carry it"
        if not self.fast or layout is None:
            return ""
        law = self.laws[0]
        most = law.gain[1:3] + SURELY * law.gain_sd[1:3]
        least = LEAST_GAIN * GRAVITY_M_S2 / abs(law.usual[0])
        if self._logged and np.all((most >= 0) & (most < least)):
            return "the gyroscope does not follow the commands"
        unsure = np.any(law.gain[1:3] < SURELY * law.gain_sd[1:3]) and self._by_all[0] < ORDER_SHOWN
        if self.misnumbered or not unsure:
            return self.misnumbered
        return (
            f"the commands change too little to tell whether its motors are numbered {self._taken}"
        )

    @property
    def _logged(self) -> bool:
        """Whether body rates are logged: rates from an attitude are late and smooth, and a
        stabilising controller then appears to rotate the body the other way."""
        return self.frame.flight.has(*GYRO)

    @cached_property
    def misnumbered(self) -> str:
        """Evidence that the motors have other numbers than assumed; "": none."""
        if not self.fast or self.frame.layout is None:
            return ""
        law, (order, free) = self.laws[0], self._by_all
        if self._logged and np.any(law.gain[1:3] < -SURELY * law.gain_sd[1:3]):
            return f"the body turns against the commands: its motors are not numbered {self._taken}"
        if free - order > ORDER_LEAVES and order < ORDER_EXPLAINS * free:
            return f"the body turns unlike the commands: its motors are not numbered {self._taken}"
        return ""

    @property
    def _taken(self) -> str:
        layout = self.frame.layout
        source = "" if layout is None else layout.source.removesuffix("; scaled")
        return f"as taken ({source}); {STATE_ORDER}"

    @cached_property
    def _by_all(self) -> Array:
        """Explained nats of roll and pitch together, as in `_by_order`."""
        return np.asarray(np.sum([self._by_order(j) for j in (1, 2)], axis=0))

    def _by_order(self, j: int) -> tuple[float, float]:
        """Nats by which the commands explain a channel in the early part: with one gain for all
        rotors in their order; with one for each rotor."""
        gram, n = self.laws[0].channels[j].gram[self.learned.stop], self.rotors
        least, order, free = (
            left_by(gram, [*used, *range(n + 1, n + 4)]) for used in ((), (n,), range(n))
        )
        return TEMPER * (least - order) / 2, TEMPER * (least - free) / 2

    @cached_property
    def authority(self) -> Array:
        """Effect of the total thrust on each channel if all of it acts to one side, by the early
        part, shape (4,)."""
        thrust = np.median(self.thrust(USUAL_CURVATURE, self.lag_s)[self.learned], axis=0)
        return np.asarray(np.abs(self.noise.gain) * (np.abs(self.signs) @ thrust))

    @cached_property
    def laws(self) -> "list[ThrustLaw]":
        """Laws of thrust by command that are consistent with the early part, the most probable
        first."""
        thrust = [self.thrust(*curve) for curve in self.curves]
        usual = [np.median(g[self.learned] @ self.signs.T, axis=0) for g in thrust]
        columns = [
            np.stack(
                [self._columns(g, j, u[j]) for g, u in zip(thrust, usual, strict=True)], axis=1
            )
            for j in range(4)
        ]
        lifts = np.array([self.lift_gain(u) for u in usual])
        left, gain, sd = np.array(
            [self._early_fit(c, j, lifts) for j, c in enumerate(columns)]
        ).transpose(1, 2, 0)
        explained = -left.sum(axis=1) / 4
        order = np.argsort(-explained)
        likely = order[explained[order] > explained.max() - LIKELY]
        found = [
            Whitened.each(law, weight, c[:, likely])
            for law, weight, c in zip(self.noise.laws, self.noise.weight, columns, strict=True)
        ]
        return [
            ThrustLaw(self.curves[i], channels, thrust[i], usual[i], gain[i], sd[i])
            for i, channels in zip(likely, zip(*found, strict=True), strict=True)
        ]

    def screening(self) -> "list[Body]":
        """The body under the most probable law of thrust, and under that with the most different
        curvature: the result of all laws together lies between."""
        first = self.laws[0]
        last = max(self.laws, key=lambda law: abs(law.curve[0] - first.curve[0]))
        return [self._under(law) for law in dict.fromkeys((first, last))]

    def _under(self, law: "ThrustLaw") -> "Body":
        """The body under one law, with the same noise."""
        found = replace(self, curves=(law.curve,))
        vars(found).update({k: v for k, v in vars(self).items() if k != "curves"}, laws=[law])
        return found

    def _columns(self, thrust: Array, j: int, usual: float) -> Array:
        each, (damping, products) = thrust * self.signs[j], self._rates
        ones, y = np.ones(len(self)), self.measured[:, j]
        return np.column_stack(
            [each, each.sum(axis=1) - usual, damping[:, j], products[:, j], ones, y]
        )

    def lift_gain(self, usual: Array) -> tuple[float, float]:
        """Gain along z, since total thrust carries the weight, and its standard deviation: a
        curvature that needs another one is less probable. With slowly logged commands, unlogged
        jitter attenuates it, and it is not informative."""
        gain = GRAVITY_M_S2 / abs(usual[0])
        return gain, LIFT_SPREAD * gain if self.fast else GAIN_SD

    def _early_fit(self, columns: Array, j: int, lifts: Array) -> Array:
        """Residual sum of squares of a channel's regression in the early part, gain, and its
        standard deviation, by law of thrust, shape (3, laws)."""
        law, early = self.noise.laws[j], self.learned
        rows = law.filtered(columns[early, :, self.rotors :]) / law.sd
        rows *= np.sqrt(self.noise.weight[j][early])[:, None, None]
        gram = np.einsum("tia,tib->iab", rows, rows)
        if j == 0:
            gram = expecting(gram, 0, *lifts.T)
        inside = gram[:, :4, :4] + 1e-6 * np.eye(4) * (gram[:, :4, :4] + 1e-9)
        cross, inverse = gram[:, :4, 4:], np.linalg.inv(inside)
        fit = (inverse @ cross)[:, :, 0]
        left = gram[:, 4, 4] - np.sum(cross[:, :, 0] * fit, axis=1)
        return np.stack([left, fit[:, 0], np.sqrt(inverse[:, 0, 0])])


@dataclass(frozen=True, eq=False)
class ThrustLaw:
    """Thrust by command of one curvature and lag, with its effects in the early part.

    Attributes:
        curve: Curvature, as in `lift`, and lag of thrust behind the command, s.
        channels: Whitened columns [S g_1 .. S g_n, their sum - K, damping, products, 1, y] of each
            channel.
        thrust: Thrust of each rotor over that at full command, shape (n, rotors).
        usual: Constant K of each channel, shape (4,).
        gain: Gain of the total thrust, shape (4,).
        gain_sd: Standard deviation of the gain, shape (4,).
    """

    curve: tuple[float, float]
    channels: tuple[Whitened, ...]
    thrust: Array
    usual: Array
    gain: Array
    gain_sd: Array

    @cached_property
    def _cumulated(self) -> Array:
        return np.concatenate([np.zeros((1, self.thrust.shape[1])), self.thrust.cumsum(axis=0)])

    def mean_thrust(self, start: Places, end: Places) -> Array:
        """Mean thrust of each rotor within windows, shape (windows, rotors)."""
        return np.asarray(
            (self._cumulated[end] - self._cumulated[start]) / np.maximum(end - start, 1)[:, None]
        )


def expecting(gram: Array, column: int, mean: Array | float, sd: Array | float) -> Array:
    """Gram matrices, shape (n, k, k), y last, with a normal prior on the number of a column."""
    out, last = gram.copy(), gram.shape[1] - 1
    precision = 1 / np.square(sd)
    out[:, column, column] += precision
    out[:, column, last] += precision * mean
    out[:, last, column] += precision * mean
    out[:, last, last] += precision * np.square(mean)
    return out


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the channels.

    Attributes:
        laws: Noise law of each channel.
        gain: Gain of the total thrust in the early part, shape (4,).
        weight: Weight of each interval, 0..1, shape (4, n).
    """

    laws: tuple[Law, ...]
    gain: Array
    weight: Array


def left_by(gram: Array, used: Sequence[int]) -> float:
    """Residual sum of squares of the last column after regression on some columns, by a Gram
    matrix, shape (k, k)."""
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-12))
    unit, used = gram * scale[:, None] * scale, list(used)
    fit = np.linalg.lstsq(unit[np.ix_(used, used)], unit[used, -1], rcond=1e-9)[0]
    return float(gram[-1, -1] * (1 - unit[used, -1] @ fit))


def robust_fit(X: Array, y: Array) -> Array:
    """Huber regression by iterative reweighting."""
    w = np.ones(len(y))
    for _ in range(4):
        beta = np.linalg.lstsq(X * w[:, None], y * w, rcond=None)[0]
        left = np.abs(y - X @ beta)
        scale = 1.4826 * np.median(left) + 1e-9
        w = np.sqrt(np.minimum(1.0, 2.5 * scale / np.maximum(left, 1e-12)))
    return np.asarray(beta)
