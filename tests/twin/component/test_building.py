"""Functions are made in several threads at once, and each is what it is alone."""

import threading

import casadi as ca
import numpy as np
import pytest

from twin.component.along import BUILDING, Along


def step() -> ca.Function:
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    after = x
    for _ in range(20):
        after = ca.sin(after) + 0.01 * u[0] * after[::-1] + u[1]
    return ca.Function("step", [x, u], [after])


@pytest.mark.slow
def test_threads_build_and_run_beside_each_other() -> None:
    """Building waits for building; evaluation goes on meanwhile."""
    u = np.random.default_rng(2).normal(size=(77, 2))
    (alone,) = Along(step())(np.zeros(6), u)
    found: list[np.ndarray[tuple[int, int], np.dtype[np.float64]]] = []

    def build_and_run() -> None:
        for _ in range(10):
            with BUILDING:
                made = step()
            found.append(Along(made)(np.zeros(6), u)[0])

    threads = [threading.Thread(target=build_and_run) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 80
    for each in found:
        np.testing.assert_array_equal(each, alone)
