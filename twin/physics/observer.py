"""Disturbance observer of an airframe whose motion is given during a simulation.

From one instant with `restart` to the next the motion drifts from the given one by model errors.
Six first-order lags attribute the drift to causes. They act as long as the motion is given, so that
sensors read the acceleration that was flown. With `disturbance.enabled` they act afterwards, too,
and decay:

    along the thrust    a force, which the accelerometer measures
    across the thrust   gravity: the given attitude is tilted, roll and pitch, against the airframe
    angular             a moment

Motion alone does not separate a force across the thrust from a tilt. A degree of tilt gives 0.17
m/s2; attitudes of motion capture and of autopilots have errors of 1 to 3 degrees, and there a force
would make the accelerometer wrong by that amount (0.44 instead of 0.07 m/s2, NanoBench). A tilt
does not change it.

A given motion contains the effect of the forces from outside already. They act once the motion is
no longer given, and their own lag is taken off the learned disturbance:

    given    x' = f(x) + d              alone    x' = f(x) + outside + d - lag(outside)

Source: Luenberger's observer with an integrating disturbance; Chen, Yang, Guo & Li, IEEE Trans.
Industrial Electronics 63, 2016, sec. II.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from ..component import ComponentBuilder
from ..effects.stages import Motion
from ..frames import AXES, FRD, to_body
from .rigid_body import MOTION, START

LAG_S, FADE_S = 0.2, 5.0
"""Time constants of learning and decay. Of lags of 0.1, 0.2 and 0.4 s and decays of 0.5, 1, 2 and
5 s and none these are best over four flights (NanoBench and RflySimDT), each with a vehicle that it
did not teach. The trim of a flight does not decay: with 31 and 35 rad/s2 of it, 5 s leaves 0.78 of
the velocity error and 0.65 of the attitude error that 1 s leaves after 0.5 s; below 3 rad/s2 0.98
to 1.05."""
LEARNED = (
    *((f"gravity_{a}", "m/s2", f"Gravity by a tilt of the given attitude, body {d}")
      for a, d in zip("xy", FRD, strict=False)),
    ("force_z", "N", f"Force that the equations lack, body {FRD[2]}"),
    *((f"moment_{a}", "N.m", f"Moment that the equations lack, about {d}")
      for a, d in zip(AXES, FRD, strict=True)),
)  # fmt: skip
"""Learned disturbances, in the order of accelerations x, y, z and angular ones: name, unit,
meaning."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Learned disturbance; zero where the twin is alone and the observer is off, shape (3,) each.

    Attributes:
        outside: Force, N, and moment, N m, from outside that act, body FRD, shape (6,).
        force_b: Force, body FRD, N.
        moment_b: Moment, body FRD, N m.
        gravity_b: Acceleration that the accelerometer does not measure, body FRD, m/s2.
        alone_s: Time since the motion was given, or since the start, s.
    """

    outside: Sequence[ca.SX]
    force_b: Sequence[ca.SX]
    moment_b: Sequence[ca.SX]
    gravity_b: Sequence[ca.SX]
    alone_s: ca.SX


def never_followed(outside: Sequence[ca.SX]) -> Disturbance:
    """Disturbance of an airframe whose motion is never given."""
    nothing = [ca.SX(0)] * 3
    return Disturbance(outside, nothing, nothing, nothing, ca.SX(0))


def followed(
    m: ComponentBuilder, motion: Motion, period: ca.SX, outside: Sequence[ca.SX]
) -> Disturbance:
    """Let inputs set the motion during a simulation, and learn the disturbance meanwhile.

    Args:
        m: Builder of the airframe.
        motion: States of the airframe.
        period: Time between two sample instants, s.
        outside: Force, N, and moment, N m, given from outside, body FRD, shape (6,).
    """
    now = m.input("restart", "1", "Whether the motion is the given one", kind="boolean") > 0.5
    given = {
        name: m.input(f"restart.{name}", unit, f"Given {meaning}", START.get(name, 0.0))
        for name, unit, meaning in MOTION
    }
    q = [given[f"q_{a}"] for a in "wxyz"]
    length = ca.sqrt(sum((c * c for c in q), start=ca.SX(0)))
    given |= {f"q_{a}": c / ca.fmax(length, 1e-12) for a, c in zip("wxyz", q, strict=True)}
    states = (*motion.pos_n, *motion.vel_n, *motion.q_nb, *motion.omega_b)
    for (name, _, _), state in zip(MOTION, states, strict=True):
        m.update(name, ca.if_else(now, given[name], state))

    on = m.parameter(
        "disturbance.enabled",
        0.0,
        "1",
        "Whether what the equations lack while the motion is given acts afterwards",
        kind="boolean",
        minimum=0,
        maximum=1,
    )
    before = m.memory("restart.before", "1", "whether the motion was given an instant ago")
    m.update("restart.before", now)
    alone_s = m.memory("alone", "s", "time since the motion was given")
    m.update("alone", ca.if_else(now, 0.0, alone_s + period))
    follows = ca.logic_and(now, before > 0.5)
    mass, acts = motion.body.mass, []
    causes = [outside[0] / mass, outside[1] / mass, *outside[2:]]
    drifts = _drift(motion, given)
    for (name, unit, meaning), lacks, said in zip(LEARNED, drifts, causes, strict=True):
        lag, fade = (
            m.parameter(f"disturbance.{kind}.{name}", start, "s", text, minimum=1e-2)
            for kind, start, text in (
                ("lag", LAG_S, f"Time constant in which it is learned, {name}"),
                ("fade", FADE_S, f"Time constant in which it fades, {name}"),
            )
        )
        known = m.memory(f"disturbance.{name}", unit, meaning)
        there = m.memory(f"disturbance.outside.{name}", unit, f"{meaning}, as said from outside")
        learned = ca.if_else(follows, known + lacks / lag, known)
        later = ca.if_else(follows, there + (said - there) * period / lag, there)
        m.update(f"disturbance.{name}", ca.if_else(now, learned, known * (1 - period / fade)))
        m.update(f"disturbance.outside.{name}", ca.if_else(now, later, there * (1 - period / fade)))
        acts.append(ca.if_else(follows, known, ca.if_else(on, known - there, 0.0)))
    nothing = ca.SX(0)
    return Disturbance(
        [ca.if_else(follows, 0.0, push) for push in outside],
        [nothing, nothing, acts[2]],
        acts[3:],
        [*acts[:2], nothing],
        alone_s,
    )


def shown(m: ComponentBuilder, disturbance: Disturbance) -> None:
    """Output the learned disturbance, and the time since the motion was given."""
    m.output("alone", "s", "Time since its motion was given, or the start", disturbance.alone_s)
    acts = (*disturbance.gravity_b[:2], disturbance.force_b[2], *disturbance.moment_b)
    for (name, unit, meaning), value in zip(LEARNED, acts, strict=True):
        m.output(f"disturbance.{name}", unit, f"{meaning}, as learned while it was set", value)


def _drift(motion: Motion, given: dict[str, ca.SX]) -> list[ca.SX]:
    """Impulses, in units of `LEARNED` times s, that move the motion to the given one."""
    drift_n = [given[f"vel_{a}"] - v for a, v in zip(AXES, motion.vel_n, strict=True)]
    x, y, z = to_body(motion.q_nb, drift_n)
    turned = [given[f"omega_{a}"] - w for a, w in zip(AXES, motion.omega_b, strict=True)]
    moments = [
        sum((j * w for j, w in zip(row, turned, strict=True)), start=ca.SX(0))
        for row in motion.body.inertia
    ]
    return [x, y, motion.body.mass * z, *moments]
