"""Along a record in chunks: bit for bit what a single call gives, whatever the length."""

import casadi as ca
import numpy as np
import pytest

from twin.component import along


def pendulum() -> ca.Function:
    """State (angle, rate), a torque and a damping per row; the energy besides."""
    x, torque, damping = ca.SX.sym("x", 2), ca.SX.sym("torque"), ca.SX.sym("damping")
    rate = x[1] + 0.01 * (torque - ca.sin(x[0]) - damping * x[1])
    after = ca.vertcat(x[0] + 0.01 * rate, rate)
    return ca.Function("pendulum", [x, torque, damping], [after, rate**2 / 2 - ca.cos(x[0])])


@pytest.mark.parametrize("n", [1, 6, 7, 8, 14, 20])
def test_chunks_follow_on_each_other(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(along, "CHUNK", 7)
    rng, step = np.random.default_rng(n), pendulum()
    torque, start = rng.normal(size=(n, 1)), np.array([0.3, -0.1])
    damping = np.broadcast_to(0.2, (n, 1))
    after, energy = along.accumulated(step, start, torque, damping)
    whole = step.mapaccum("whole", n).call([start, torque.T, damping.T])
    for found, wanted in zip((after, energy), whole, strict=True):
        np.testing.assert_array_equal(found, np.asarray(wanted).T)
    states = np.vstack([start, after[:-1]])
    np.testing.assert_array_equal(along.mapped(step, states, torque, damping), after)
