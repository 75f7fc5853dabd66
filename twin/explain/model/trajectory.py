"""States and inputs of the airframe along a flight, as the effects' numbers have them.

What is measured is given; beside it an effect may have

| states | which here |
|---|---|
| of its own, or that it moves and nobody measures | are integrated again along the flight |
| that an observer follows from what is felt | are placed by the observer |
| that are late, as commands may be | are shifted, and so is the pose by its age |
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...effects import EFFECTS
from ...frames import to_ned
from ...logs import Flight
from ...logs.columns import ACC
from ...residuals.aligned import AlignedFlight, align_flight
from ...residuals.channels import GRID_HZ, on_grid, shifted
from ...residuals.measured import Signal
from ...residuals.teacher_forced import (
    SPIN_RATE,
    hidden_states,
    rotor_states_of,
    with_rotor_states,
)
from ...vehicle import Vehicle
from .numbers import DRIVES, PLACE, TURN, Number, age_of, lateness_of, values_of, with_effects
from .prediction import Physics

Array = NDArray[np.float64]
Key = TypeVar("Key")
Made = TypeVar("Made")
REMEMBERED = 16
"""Courses of states that are not measured, and what they follow, by the numbers."""


class Trajectory:
    """The airframe along one flight.

    Attributes:
        aligned: The flight on its grid, with the model as it stands.
    """

    def __init__(
        self,
        flight: Flight,
        vehicle: Vehicle,
        physics: Physics,
        effects: Sequence[str],
        numbers: Sequence[Number],
    ) -> None:
        """Put the flight on the grid. Arguments as of `FlightModel`."""
        self._flight, self._vehicle, self._physics = flight, vehicle, physics
        self._effects, self._numbers = list(effects), list(numbers)
        self._observers = {name: o for name in effects if (o := EFFECTS[name].observer) is not None}
        self._stateful = sorted(
            {n.effect for n in numbers if self._reached(n.full)} - self._observers.keys()
        )
        on = with_effects(vehicle, self._stateful, {})
        self.aligned = align_flight(flight, on, 1 / GRID_HZ, effects)
        self._now = values_of(numbers, {})
        self._forces: dict[tuple[str, bytes], tuple[Array, Array]] = {}
        self._courses: dict[tuple[str, bytes, tuple[float, ...]], Any] = {}
        self._integrated: dict[tuple[tuple[str, float], ...], AlignedFlight] = {}
        states = self._observed(self.aligned.states, self.aligned.inputs.u, self._now)
        self.aligned = replace(self.aligned, states=states)

    def at(self, change: Mapping[str, float]) -> tuple[Array, Array]:
        """States, shape (n, n_x), and inputs, shape (n, n_u), with some numbers changed.

        Args:
            change: "effect.number" -> value, for those that differ from the model as it stands.
        """
        theta = values_of(self._numbers, change)
        own = {k: v for k, v in change.items() if self.is_integrated(k, change)}
        aligned = self.aligned
        if own:
            key = tuple(sorted(own.items()))
            aligned = _remembered(self._integrated, key, lambda: self._integrated_with(own))
        states, inputs = self._in_step(aligned.states, theta), aligned.inputs.u
        for signal in DRIVES:
            if later := lateness_of(self._numbers, theta, signal):
                states, inputs = self._late_drive(states, inputs, signal, later)
        return self._observed(states, inputs, theta), inputs

    def is_integrated(self, number: str, change: Mapping[str, float]) -> bool:
        """Whether a state that answers to a number matters: not of an effect that is at rest, and
        not followed by an observer."""
        own = number.partition(".")[0]
        if own in self._observers:
            return False
        acting = {own, *self._vehicle.effects, *(name.partition(".")[0] for name in change)}
        resting = set(self._effects) - acting | self._observers.keys()
        names = (self.aligned.airframe.states[i].name for i in self._reached(number))
        return any(name.partition(".")[0] not in resting for name in names)

    def is_followed(self, effect: str) -> bool:
        """Whether an observer places the states of an effect, by its numbers."""
        return effect in self._observers

    def _reached(self, number: str) -> frozenset[int]:
        """States of the airframe that nobody measures and that answer to a number."""
        return self._physics.reached.get(number, frozenset())

    def _in_step(self, states: Array, theta: Array) -> Array:
        """States with the ages of the pose taken out."""
        for signals in (PLACE, TURN):
            if age := age_of(self._numbers, theta, signals):
                stems = tuple(f"{s}_" for s in signals)
                if signals == TURN and not self.aligned.motion.rates_measured:
                    stems += ("omega_",)  # they come from the attitude
                names = [s.name for s in self.aligned.airframe.states]
                own = [i for i, name in enumerate(names) if name.startswith(stems)]
                states = states.copy()
                states[:, own] = shifted(states[:, own], -age)
        return states

    def _integrated_with(self, values: Mapping[str, float]) -> AlignedFlight:
        """The flight on its grid, unmeasured states integrated with effects that move them."""
        effects = {name.partition(".")[0] for name in values}
        known = {v.name for v in self.aligned.airframe.parameters}
        on = {f"{e}.enabled": 1.0 for e in effects}
        moving = effects | {*self._stateful}
        starts = on | {n.full: n.now for n in self._numbers if n.effect in moving} | dict(values)
        body = self.aligned.airframe.with_starts({k: v for k, v in starts.items() if k in known})
        reached: set[int] = set().union(*(self._reached(name) for name in values))
        inputs, states = self.aligned.inputs, self.aligned.states.copy()
        rotors = rotor_states_of(body)
        if reached & {*rotors}:
            inputs = with_rotor_states(inputs, body)
            states[:, rotors] = inputs.rotor_states
        followed = {i for i, s in enumerate(body.states) if _owner(s.name) in self._observers}
        if hidden := sorted(reached - {*rotors} - followed):
            states[:, hidden] = hidden_states(body, hidden, states, inputs)
        return replace(self.aligned, airframe=body, inputs=inputs, states=states)

    def _excess_force(self, theta: Array, states: Array, inputs: Array) -> tuple[Array, Array]:
        """Specific force at some numbers, and what is felt beyond it, NED, (n, 3) each.

        Where the former is unknown, or on the ground, the vehicle counts as held.
        """
        aligned = self.aligned
        force = self._physics.value(theta, states, inputs)[:, :3]
        excess = np.zeros_like(force)
        if self._flight.has(*ACC):
            excess = on_grid(Signal(*self._flight.signal(ACC)), aligned.inputs.t_s) - force
        assert aligned.motion.attitude is not None
        q = list(aligned.motion.attitude.at(aligned.inputs.t_s).T)
        force_n, excess_n = (np.stack(to_ned(q, list(v.T)), axis=-1) for v in (force, excess))
        known = aligned.airborne & np.all(np.isfinite(force_n), axis=1)
        there = known & np.all(np.isfinite(excess_n), axis=1)
        return (
            np.where(known[:, None], force_n, [0.0, 0.0, -self._vehicle.gravity_m_s2]),
            np.where(there[:, None], excess_n, 0.0),
        )

    def _observed(self, states: Array, inputs: Array, theta: Array) -> Array:
        """States with those of effects in place that an observer follows, by what is felt beyond
        everything else; of an effect at rest, beyond the model as it stands."""
        names = [s.name for s in self.aligned.airframe.states]
        for effect, observer in self._observers.items():
            own = [i for i, n in enumerate(self._numbers) if n.effect == effect]
            sizes = [i for i in own if not self._numbers[i].shape]
            neutral = [float(self._numbers[i].about.neutral or 0.0) for i in sizes]
            without = self._now.copy() if np.array_equal(theta[sizes], neutral) else theta.copy()
            without[own] = self._now[own]
            without[sizes] = neutral
            at = effect, without.tobytes()
            free, excess = _remembered(
                self._forces, at, partial(self._excess_force, without, states, inputs)
            )
            numbers = {self._numbers[i].name: float(theta[i]) for i in own}
            course = _remembered(
                self._courses,
                (*at, tuple(float(theta[i]) for i in own if i not in sizes)),
                partial(observer.follow, free, excess, numbers, 1 / GRID_HZ),
            )
            states = observer.place(states, names, course, free, numbers, self._vehicle)
        return states

    def _late_drive(
        self, states: Array, inputs: Array, signal: str, delay_s: float
    ) -> tuple[Array, Array]:
        """What drives the airframe, and the rotors that follow it, later by a while."""
        body = self.aligned.airframe
        own = (f"{signal}_", SPIN_RATE) if signal == "rotor" else (f"{signal}_",)
        drives = [i for i, n in enumerate(body.input_names) if n.startswith(own)]
        if not drives:
            return states, inputs
        arrived = tuple(f"{n.effect}." for n in self._numbers if n.acts)
        rotors = [
            i
            for i, s in enumerate(body.states)
            if s.name.startswith(("rotor_", "effort_", *arrived))
        ]
        states, inputs = states.copy(), inputs.copy()
        states[:, rotors] = shifted(states[:, rotors], delay_s)
        inputs[:, drives] = shifted(inputs[:, drives], delay_s)
        return states, inputs


def _remembered(retained: dict[Key, Made], key: Key, make: Callable[[], Made]) -> Made:
    """What was made before, or is made now; the oldest goes where there are many."""
    if key not in retained:
        while len(retained) >= REMEMBERED:
            del retained[next(iter(retained))]
        retained[key] = make()
    return retained[key]


def _owner(state: str) -> str:
    """Effect that a state belongs to; of others, something else."""
    return state.partition(".")[0]
