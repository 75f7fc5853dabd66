"""Closed-loop simulation of vehicle, controller and mission in Python, without FMUs.

All steps run inside one CasADi function, so a minute of flight takes seconds. Each step is that of
a Jacobi co-simulation in which the controller answers without delay: outputs of the airframe, then
the controller's, then both advance with their inputs held.

`fly_missions` flies every mission with a vehicle to which effects were added, and reports whether
it remains stable.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component, unknown_name
from ..component.along import accumulated
from ..errors import ModelError, TwinError
from ..frames import AXES
from ..logs.samples import stretches_where
from ..physics.airframe import airframe
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .control_laws import drives, thrust_inverse
from .lqr import controller
from .mission import PHASES, mission, mission_duration_s, mission_names

Array = NDArray[np.float64]
STEP_S = 1e-3
"""Step of the loop, s: that of the co-simulation."""
SETPOINTS = (
    *(f"setpoint_{kind}_{a}" for kind in ("pos", "vel", "acc") for a in AXES),
    "setpoint_yaw",
    "armed",
)
"""Inputs of a controller that a mission provides, in order."""
AT_BOUND = 1e-6
"""Distance of a command from a bound below which it is at the bound."""


@dataclass(frozen=True, slots=True)
class Trajectory(ShortRepr):
    """A closed-loop flight, one row per step.

    Attributes:
        t_s: Times, shape (n,).
        states: States of the airframe, shape (n, n_x).
        inputs: Inputs of the airframe, shape (n, n_u).
        setpoints: Setpoints in the order of `SETPOINTS`, shape (n, 11).
        phase: Codes of `mission.PHASES`, shape (n,).
        body: The airframe that flew.
        bounds: Lower and upper bound of the rotor inputs.
    """

    t_s: Array
    states: Array
    inputs: Array
    setpoints: Array
    phase: Array
    body: Component
    bounds: tuple[float, float]

    def state(self, *names: str) -> Array:
        """States by name, shape (n, len(names))."""
        known = [s.name for s in self.body.states]
        return self.states[:, [known.index(n) for n in names]]

    @property
    def drives(self) -> Array:
        """Rotor inputs, shape (n, n_rotors)."""
        return self.inputs[:, [self.body.input_names.index(n) for n in drives(self.body)]]

    @property
    def flying(self) -> NDArray[np.bool_]:
        """Whether the mission is off the ground, shape (n,)."""
        return np.asarray(self.phase != PHASES["ground"])

    @property
    def miss_m(self) -> Array:
        """Distance from the setpoint while flying, shape (k,)."""
        off = self.state("pos_x", "pos_y", "pos_z") - self.setpoints[:, :3]
        return np.asarray(np.linalg.norm(off[self.flying], axis=1))

    @property
    def saturated_s(self) -> float:
        """Longest time of any one rotor at a bound while flying."""
        low, high = self.bounds
        at = (self.drives <= low + AT_BOUND) | (self.drives >= high - AT_BOUND)
        at &= self.flying[:, None]
        lengths = (end - first for column in at.T for first, end in stretches_where(column))
        longest = max(lengths, default=0)
        return longest * float(self.t_s[1] - self.t_s[0])

    @property
    def tilt_rad(self) -> Array:
        """Angle between thrust and vertical, shape (n,)."""
        x, y = self.state("q_x", "q_y").T
        return np.asarray(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1)))


def closed_loop(
    vehicle: Vehicle,
    name: str,
    wind_m_s: Sequence[float] = (0.0, 0.0, 0.0),
    plant: Vehicle | None = None,
    control: Component | None = None,
) -> Trajectory:
    """Fly a mission from the ground to its end.

    Args:
        vehicle: Vehicle for which the controller is designed.
        name: Name of the mission.
        wind_m_s: Steady wind, NED.
        plant: Vehicle that flies; default: the same vehicle.
        control: Controller in place of `controller(vehicle)`.
    """
    return ClosedLoop(vehicle, wind_m_s, plant, control).fly(name)


class ClosedLoop:
    """A vehicle with its controller, built once for several missions.

    Args:
        vehicle: Vehicle for which the controller is designed.
        wind_m_s: Steady wind, NED.
        plant: Vehicle that flies; default: the same vehicle.
        control: Controller in place of `controller(vehicle)`.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        wind_m_s: Sequence[float] = (0.0, 0.0, 0.0),
        plant: Vehicle | None = None,
        control: Component | None = None,
    ) -> None:
        plant = plant or vehicle
        body = airframe(plant)
        self._vehicle, self._body = vehicle, body.with_starts(standing(body, plant))
        self._bounds = (0.0, 1.0) if control is not None else thrust_inverse(vehicle).bounds
        wind = {f"wind_{a}": float(w) for a, w in zip(AXES, wind_m_s, strict=True)}
        course = _Course(self._body, wind, {}, 0)
        self._steps = _Steps(self._body, control or controller(vehicle), course)

    def fly(self, name: str) -> Trajectory:
        """Fly a mission from the ground to its end."""
        plan = mission(self._vehicle, name)
        t_s = STEP_S * np.arange(round(mission_duration_s(name) / STEP_S), dtype=np.float64)
        rows = plan.outputs_along(t_s[:, None], np.zeros((len(t_s), 0)))
        setpoints = rows[:, [plan.output_names.index(n) for n in SETPOINTS]]
        phase = rows[:, plan.output_names.index("phase")]
        states, inputs = self._steps.along(setpoints, np.zeros((len(t_s), 0)))
        return Trajectory(t_s, states, inputs, setpoints, phase, self._body, self._bounds)


def standing(body: Component, vehicle: Vehicle) -> dict[str, float]:
    """Start values of an airframe on the ground with its rotors at rest.

    Args:
        body: The airframe.
        vehicle: Vehicle of the airframe.
    """
    known = [v.name for v in body.parameters]
    rest = {n: 0.0 for n in known if n.startswith(("initial.rotor_", "initial.effort_"))}
    return {**rest, "initial.pos_z": -vehicle.leg_height_m}


def fly(
    body: Component,
    control: Component,
    setpoints: Array,
    held: Mapping[str, float] | None = None,
    courses: Mapping[str, Array] | None = None,
) -> tuple[Array, Array]:
    """Fly setpoints, one per `STEP_S`, from the airframe's start values.

    Args:
        body: Component of the airframe.
        control: Component of the controller; a sampled one must have a period of an integer number
            of steps.
        setpoints: Setpoints in the order of `SETPOINTS`, shape (n, 11).
        held: Other inputs of the airframe, such as the wind.
        courses: Inputs and parameters of the airframe that change in flight, by name, one value per
            step, shape (n,); a delay of its memory may not change.

    Returns:
        States before each step, shape (n, n_x), and the inputs over it, shape (n, n_u).
    """
    course = _Course(body, held, courses or {}, len(setpoints))
    return _Steps(body, control, course).along(setpoints, course.rows)


class _Steps:
    """Steps of an airframe and its controller with their memories, in one function."""

    def __init__(self, body: Component, control: Component, course: "_Course") -> None:
        self._body, self._control, self._course = body, control, course
        self._every, self._line = _every(control), _Memory(body)
        u0, p_body, p_control = course.u, course.p, control.parameter_values()
        x, c = ca.SX.sym("x", len(body.states)), ca.SX.sym("c", len(control.states))
        past = ca.SX.sym("past", self._line.size)
        setpoint, due = ca.SX.sym("setpoint", len(SETPOINTS)), ca.SX.sym("due")
        measured = body.outputs(x, u0, p_body)
        sources = {n: measured[i] for i, n in enumerate(body.output_names)}
        sources |= {n: setpoint[i] for i, n in enumerate(SETPOINTS)}
        sensed = ca.vertcat(*[sources[n] for n in control.input_names])
        after = c
        if control.sampling is not None:
            after = ca.if_else(due > 0.5, control.sampling.update(c, sensed, p_control, [], []), c)
        answer = control.outputs(after, sensed, p_control)
        u = ca.SX(u0)
        u[[body.input_names.index(n) for n in control.output_names]] = answer
        moved, later = self._line.sampled(body.step(x, u, p_body, STEP_S), u, past, p_body)
        both = ca.vertcat(moved, control.step(after, sensed, p_control, STEP_S), later)
        once, n = ca.cse(ca.vertcat(both, u)), both.size1()
        rows = [ca.vertcat(x, c, past), setpoint, due, course.now]
        self._step = ca.Function("closed_loop", rows, [once[:n], once[n:]])

    def along(self, setpoints: Array, rows: Array) -> tuple[Array, Array]:
        """States before each step and inputs during it, as `fly` returns them.

        Args:
            setpoints: Setpoints, shape (n, 11).
            rows: Rows of the course, shape (n, k).
        """
        body, control, line = self._body, self._control, self._line
        u_start, p_start = self._course.started()
        resting = control.initial(control.input_values(), control.parameter_values())
        start = [body.initial(u_start, p_start), resting]
        known = ca.vertcat(*start, np.zeros(line.size))
        _, first_u = self._step(known, setpoints[0], True, rows[0])
        start[:1], begun = line.begun(body.initial(first_u, p_start), first_u)
        state = np.asarray(ca.vertcat(*start, begun), dtype=np.float64).ravel()
        now = (np.arange(len(setpoints)) % self._every == 0).astype(np.float64)
        trail, inputs = accumulated(self._step, state, setpoints, now[:, None], rows)
        return np.vstack([state, trail[:-1]])[:, : len(body.states)], inputs


class _Course:
    """Inputs and parameters of an airframe; those that change in flight are symbols.

    Attributes:
        u: All inputs that are not computed by the loop.
        p: All parameters.
        now: Symbols of the changing ones.
        rows: Values of the changing ones, shape (n, k).
    """

    def __init__(
        self,
        body: Component,
        held: Mapping[str, float] | None,
        courses: Mapping[str, Array],
        n: int,
    ) -> None:
        self._body, self._held = body, dict(held or {})
        self.now = ca.SX.sym("now", len(courses))
        self.rows = np.column_stack([*courses.values()]) if courses else np.zeros((n, 0))
        self.u, self.p = ca.SX(body.input_values(held)), ca.SX(body.parameter_values())
        parameters = [v.name for v in body.parameters]
        self._first: dict[str, float] = {}
        for k, name in enumerate(courses):
            if name in body.input_names:
                self.u[body.input_names.index(name)] = self.now[k]
                self._held[name] = float(self.rows[0, k])
            elif name in parameters:
                self.p[parameters.index(name)] = self.now[k]
                self._first[name] = float(self.rows[0, k])
            else:
                known = (*body.input_names, *parameters)
                raise ModelError(unknown_name(body.name, "input or parameter", name, known))

    def started(self) -> tuple[Array, Array]:
        """Inputs and parameters at the start."""
        return self._body.input_values(self._held), self._body.parameter_values(self._first)


class _Memory:
    """Updates of an airframe at its sample instants, one per step; its delay lines are a state.

    Each line stores its last samples, the newest first, and interpolates between two of them.

    Attributes:
        size: Number of samples of all lines.
    """

    def __init__(self, body: Component) -> None:
        self._sampling, self._p = body.sampling, body.parameter_values()
        self._back: Array = np.zeros(0)
        if self._sampling is not None:
            if _every(body) != 1:
                raise ModelError(f"{body.name}: needs a sample period of {STEP_S:g} s to be flown.")
            delays_s = np.asarray(self._sampling.delays(self._p), dtype=np.float64).ravel()
            self._back = delays_s / STEP_S
        self.size = sum(int(k) + 2 for k in self._back)

    def sampled(self, x: ca.SX, u: ca.SX, past: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        """State after a sample instant, and the memory from then on."""
        if self._sampling is None:
            return x, past
        signals = self._sampling.signals(x, u, p)
        lines: list[ca.SX] = []
        delayed = []
        for i, back in enumerate(self._back):
            whole, first = int(back), sum(line.numel() for line in lines)
            line = ca.vertcat(signals[i], past[first : first + whole + 1])
            delayed.append(line[whole] + (back - whole) * (line[whole + 1] - line[whole]))
            lines.append(line)
        nothing = np.zeros(self._sampling.channels)
        after = self._sampling.update(x, u, p, nothing, ca.vertcat(*delayed))
        return after, ca.vertcat(*lines)

    def begun(self, x: ca.DM, u: ca.DM) -> tuple[list[ca.DM], ca.DM]:
        """State and memory after the first sample instant: earlier signals equal the first ones."""
        if self._sampling is None:
            return [x], ca.DM(0, 1)
        signals = self._sampling.signals(x, u, self._p)
        past = [ca.repmat(signals[i], int(k) + 2) for i, k in enumerate(self._back)]
        nothing = np.zeros(self._sampling.channels)
        return [self._sampling.update(x, u, self._p, nothing, signals)], ca.vertcat(*past)


def _every(control: Component) -> int:
    """Number of steps between two sample instants of a controller."""
    if control.sampling is None:
        return 1
    values = dict(
        zip((v.name for v in control.parameters), control.parameter_values(), strict=True)
    )
    period = float(values[control.sampling.period])
    every = round(period / STEP_S)
    if every < 1 or abs(every * STEP_S - period) > 1e-9:
        raise ModelError(
            f"{control.name}: a sample period of {period:g} s is not a whole number of steps of "
            f"{STEP_S:g} s."
        )
    return every


STEEPEST_RAD = np.radians(75.0)
"""Tilt beyond which a vehicle is lost. Made up."""
FARTHEST_ARMS, FARTHEST_M = 10.0, 0.5
"""Distance from the setpoint, in rotor arms and in metres, beyond which a vehicle is lost."""


@dataclass(frozen=True, slots=True)
class Mission:
    """A mission flown in closed loop.

    Attributes:
        name: Name of the mission.
        stable: Whether it was flown to its end, upright and near its setpoints.
        worst_m: Largest distance from the setpoint; NaN where no flight was possible.
        problem: Reason why it is not stable; "" where it is.
    """

    name: str
    stable: bool
    worst_m: float
    problem: str


def fly_missions(
    vehicle: Vehicle,
    names: Sequence[str] | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Mission, ...]:
    """Fly missions with the controller designed for the vehicle's own numbers.

    Args:
        vehicle: Vehicle with its effects.
        names: Names of the missions; default: all.
        progress: Called with the completed share.
    """
    names = list(mission_names() if names is None else names)
    try:
        loop = ClosedLoop(vehicle)
    except TwinError as error:
        return tuple(Mission(name, False, float("nan"), str(error)) for name in names)
    flown = []
    for i, name in enumerate(names):
        flown.append(_fly(vehicle, loop, name))
        progress((i + 1) / len(names))
    return tuple(flown)


def _fly(vehicle: Vehicle, loop: ClosedLoop, name: str) -> Mission:
    try:
        flight = loop.fly(name)
    except TwinError as error:
        return Mission(name, False, float("nan"), str(error))
    if not np.all(np.isfinite(flight.states)):
        return Mission(name, False, float("nan"), "the simulation diverges")
    worst, tilt = float(flight.miss_m.max()), float(flight.tilt_rad.max())
    problem = lost(worst, tilt, vehicle.arm_m)
    return Mission(name, not problem, worst, problem)


def lost(miss_m: float, tilt_rad: float, arm_m: float) -> str:
    """Reason why a flight counts as lost; "" where it does not.

    Args:
        miss_m: Largest distance from the setpoint.
        tilt_rad: Largest tilt.
        arm_m: Distance from the centre to a rotor.
    """
    farthest_m, problems = max(FARTHEST_M, FARTHEST_ARMS * arm_m), []
    if not tilt_rad <= STEEPEST_RAD:
        problems.append(f"tilts to {np.degrees(tilt_rad):.0f} degrees")
    if not miss_m <= farthest_m:
        problems.append(f"{miss_m:.2f} m from the setpoint, more than {farthest_m:.2f} m")
    return "; ".join(problems)
