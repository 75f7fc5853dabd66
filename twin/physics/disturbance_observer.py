"""A motion that is given while the airframe runs, and what the equations lack meanwhile."""

import casadi as ca

from ..component import ComponentBuilder
from ..effects import Period
from ..effects.stages import Motion
from ..frames import AXES, to_body
from .rigid_body import MOTION, OUTSIDE, START

RESTART_PERIOD_S = 1e-3
"""The communication step of the co-simulation."""
RESTARTS = Period(RESTART_PERIOD_S, "Time between two instants at which it can be set anew")
LAG_S, FADE_S = 0.2, 1.0
"""Of 0.1, 0.2 and 0.5 s, and fades of 0.7 and 1 s, on the residuals of three real hovers
(RflySimDT) none forecast half a second better by more than a tenth."""


def followed(m: ComponentBuilder, motion: Motion, period: ca.SX) -> list[ca.SX]:
    """Let inputs set the motion while the component runs; force and moment learned meanwhile.

    From one instant with `restart` to the next the motion drifts from the given one by what the
    equations lack. That is put down to a force and a moment, in a first-order lag, which act from
    then on and fade once the motion is no longer given: a disturbance observer.

    Args:
        m: Of the airframe.
        motion: Its states.
        period: Time between two of its instants, s, a multiple of `RESTART_PERIOD_S`.

    Returns:
        Force and moment, body FRD, 6 rows; zero while the observer is switched off.

    Source: Luenberger's observer with an integrating disturbance; Chen, Yang, Guo & Li, IEEE
    Trans. Industrial Electronics 63, 2016, sec. II.
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
    follows = ca.logic_and(now, before > 0.5)
    drift_n = [given[f"vel_{a}"] - v for a, v in zip(AXES, motion.vel_n, strict=True)]
    missing = [motion.body.mass * v for v in to_body(motion.q_nb, drift_n)]
    turned = [given[f"omega_{a}"] - w for a, w in zip(AXES, motion.omega_b, strict=True)]
    missing += [
        sum((j * w for j, w in zip(row, turned, strict=True)), start=ca.SX(0))
        for row in motion.body.inertia
    ]
    acts = []
    for (name, unit, meaning), lacks in zip(OUTSIDE, missing, strict=True):
        lag, fade = (
            m.parameter(f"disturbance.{kind}.{name}", start, "s", text, minimum=1e-2)
            for kind, start, text in (
                ("lag", LAG_S, f"Time constant in which it is learned, {name}"),
                ("fade", FADE_S, f"Time constant in which it fades, {name}"),
            )
        )
        known = m.memory(f"disturbance.{name}", unit, f"what the equations lack, {meaning}")
        learned = ca.if_else(follows, known + lacks / lag, known)
        m.update(f"disturbance.{name}", ca.if_else(now, learned, known * (1 - period / fade)))
        acts.append(ca.if_else(on, known, 0.0))
    return acts
