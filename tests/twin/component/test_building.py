"""Functions are made in several threads at once, and each is what it is alone."""

import threading
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from twin.component.along import BUILDING, Along
from twin.component.builder import BUILT
from twin.physics.airframe import airframe
from twin.vehicle_file import load_vehicle


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


def test_an_airframe_is_built_once_in_a_thread() -> None:
    vehicle = load_vehicle("copter_default")
    made = airframe(vehicle, "command", ["rotor_drag"])
    assert airframe(load_vehicle("copter_default"), "command", ["rotor_drag"]) is made
    assert airframe(vehicle, "command") is not made
    heavier = airframe(replace(vehicle, mass_kg=vehicle.mass_kg * 1.5), "command", ["rotor_drag"])
    assert heavier.input_values()[0] > made.input_values()[0]
    elsewhere = []
    other = threading.Thread(target=lambda: elsewhere.append(airframe(vehicle, "command")))
    other.start()
    other.join()
    assert elsewhere[0] is not airframe(vehicle, "command")
    for k in range(BUILT):  # the oldest go
        airframe(replace(vehicle, mass_kg=vehicle.mass_kg * (1 + 0.01 * k)), trimmed=False)
    assert airframe(vehicle, "command", ["rotor_drag"]) is not made
