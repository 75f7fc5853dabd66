"""Along a record in chunks: bit for bit what a single call gives, whatever the length."""

import casadi as ca
import numpy as np
import pytest

from twin.component import along
from twin.component.rows import OverRows


def pendulum() -> ca.Function:
    """State (angle, rate), a torque and a damping per row; the energy besides."""
    x, torque, damping = ca.SX.sym("x", 2), ca.SX.sym("torque"), ca.SX.sym("damping")
    rate = x[1] + 0.01 * (torque - ca.sin(x[0]) - damping * x[1])
    after = ca.vertcat(x[0] + 0.01 * rate, rate)
    return ca.Function("pendulum", [x, torque, damping], [after, rate**2 / 2 - ca.cos(x[0])])


@pytest.mark.parametrize("n", [1, 6, 7, 8, 14, 20])
def test_chunks_follow_on_each_other(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for size in ("CHUNK", "STEPS"):
        monkeypatch.setattr(along, size, 7)
    rng, step = np.random.default_rng(n), pendulum()
    torque, start = rng.normal(size=(n, 1)), np.array([0.3, -0.1])
    damping = np.broadcast_to(0.2, (n, 1))
    after, energy = along.accumulated(step, start, torque, damping)
    whole = step.mapaccum("whole", n).call([start, torque.T, damping.T])
    for found, wanted in zip((after, energy), whole, strict=True):
        np.testing.assert_array_equal(found, np.asarray(wanted).T)
    states = np.vstack([start, after[:-1]])
    np.testing.assert_array_equal(along.mapped(step, states, torque, damping), after)


def test_blocks_follow_on_each_other() -> None:
    """The loops that are kept serve blocks of any length, with what changes and what does not."""
    rng, step = np.random.default_rng(5), pendulum()
    torque, damping = rng.normal(size=(90, 1)), rng.uniform(size=(90, 1))
    start = np.array([0.3, -0.1])
    whole, _ = along.accumulated(step, start, torque, damping)
    one, first, state = along.Along(step), 0, start
    for n in (3, 13, 1, 30, 43):
        part, _ = one(state, torque[first : first + n], damping[first : first + n])
        np.testing.assert_array_equal(part, whole[first : first + n])
        first, state = first + n, part[-1]


def test_outputs_with_holes_are_filled() -> None:
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u")
    turned = ca.Function("turned", [x, u], [ca.vertcat(x[0] + u, ca.SX(1, 1), x[0])])
    (found,) = along.accumulated(turned, np.array([1.0, 5.0, 6.0]), np.ones((2, 1)))
    np.testing.assert_array_equal(found, [[2.0, 0.0, 1.0], [3.0, 0.0, 2.0]])


@pytest.mark.parametrize("n", [1, 5, 100])
def test_each_row_is_that_of_one_call(n: int) -> None:
    rng, step = np.random.default_rng(n), pendulum()
    states, torque, damping = rng.normal(size=(n, 2)), rng.normal(size=(n, 1)), np.array([0.2])
    found = along.EachRow(step, 2)(states, torque, damping)
    wanted = [np.asarray(step(x, t, 0.2)[0]).ravel() for x, t in zip(states, torque, strict=True)]
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_allclose(found, OverRows(step, 2)(states, torque, damping), rtol=1e-14)
