"""Saved states are exact to the bit, and a state of anything else is refused."""

from collections.abc import Callable
from ctypes import byref, c_void_p

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from instance import Instance
from kinds import component

New = Callable[[str, int], Instance]
CASES = [
    (kind, fmi)
    for kind in ("airframe-crazyflie", "imu-filtered", "battery", "replay")
    for fmi in (2, 3)
]


def disturb(instance: Instance, kind: str, seed: int) -> None:
    """New values of all inputs, and of one tunable parameter."""
    if kind == "replay":
        return
    rng = np.random.default_rng(seed)
    instance.set({v.name: v.start + rng.standard_normal() for v in component(kind).inputs})
    tunable = next(v for v in component(kind).parameters if not v.fixed and v.real)
    instance.set({tunable.name: tunable.start * rng.uniform(0.9, 1.1)})


def segment(instance: Instance, kind: str, first: int, seed: int) -> bytes:
    """Outputs over 20 steps with an input change half way, as bytes."""
    rows = [instance.outputs(), *instance.run(10, first)]
    disturb(instance, kind, seed)
    return np.array([*rows, *instance.run(10, first + 10)]).tobytes()


@pytest.mark.parametrize(("kind", "fmi"), CASES)
def test_restored_run_repeats_bit_by_bit(new: New, kind: str, fmi: int) -> None:
    rng = np.random.default_rng(fmi)
    instance, other = new(kind, fmi).start(), new(kind, fmi)
    at = 0
    for save in rng.integers(1, 40, size=5):
        instance.run(int(save), at)
        at += int(save)
        disturb(instance, kind, at)  # saved with an input that no step has seen yet
        state = instance.fmu.getFMUState()
        text = instance.fmu.serializeFMUState(state)
        first = segment(instance, kind, at, seed=at)
        instance.fmu.setFMUState(state)
        assert instance.fmu.serializeFMUState(instance.fmu.getFMUState()) == text
        assert segment(instance, kind, at, seed=at) == first
        # In another instance, never initialised, from the bytes alone.
        rebuilt = other.fmu.deserializeFMUState(text)
        other.fmu.setFMUState(rebuilt)
        assert segment(other, kind, at, seed=at) == first
        at += 20
        instance.fmu.freeFMUState(state)
        other.fmu.freeFMUState(rebuilt)


@pytest.mark.parametrize("fmi", [2, 3])
def test_state_during_initialisation(new: New, fmi: int) -> None:
    """What comes back is the mode as well: initial values can be set again."""
    instance = new("battery", fmi)
    instance.enter({"initial.charge": 0.25})
    state = instance.fmu.getFMUState()
    instance.leave()
    instance.run(3)
    instance.fmu.setFMUState(state)
    instance.set({"initial.charge": 0.5})
    instance.leave()
    assert instance.get("charge") == 0.5
    instance.fmu.freeFMUState(state)


@pytest.mark.parametrize("fmi", [2, 3])
def test_state_is_saved_into_memory_given(new: New, fmi: int) -> None:
    """A second get into the same handle reuses it."""
    instance = new("battery", fmi).start()
    state = instance.fmu.getFMUState()
    handle = c_void_p(state.value)
    instance.run(5)
    get = instance.fmu.fmi2GetFMUstate if fmi == 2 else instance.fmu.fmi3GetFMUState
    get(instance.fmu.component, byref(handle))
    assert handle.value == state.value
    charge = instance.get("charge")
    instance.run(5, 5)
    instance.fmu.setFMUState(handle)
    assert instance.get("charge") == charge
    instance.fmu.freeFMUState(handle)


@pytest.mark.parametrize("fmi", [2, 3])
def test_foreign_states_are_refused(new: New, fmi: int) -> None:
    instance = new("battery", fmi).start()
    instance.run(7)
    before = instance.outputs().tobytes()
    state = instance.fmu.getFMUState()
    good = instance.fmu.serializeFMUState(state)
    foreign = new("imu", fmi).start()
    foreign_bytes = foreign.fmu.serializeFMUState(foreign.fmu.getFMUState())
    other_version = new("battery", 5 - fmi).start()
    other_bytes = other_version.fmu.serializeFMUState(other_version.fmu.getFMUState())
    size = len(good)
    assert len(other_bytes) == size  # the same states, told apart by the tag alone
    for content, text in (
        (b"", f"saved state has 0 bytes, expected {size}"),
        (good[:-1], f"saved state has {size - 1} bytes, expected {size}"),
        (good + b"\0", f"saved state has {size + 1} bytes, expected {size}"),
        (foreign_bytes, f"saved state has {len(foreign_bytes)} bytes, expected {size}"),
        (other_bytes, "belongs to another FMU or another version of this one"),
        (b"\xff" * size, "belongs to another FMU or another version of this one"),
    ):
        with pytest.raises(FMICallException):
            instance.fmu.deserializeFMUState(content)
        assert text in instance.messages[-1]
        assert instance.outputs().tobytes() == before
    # A handle of another FMU, not only its bytes.
    with pytest.raises(FMICallException):
        instance.fmu.setFMUState(foreign.fmu.getFMUState())
    assert "belongs to another FMU" in instance.messages[-1]
    with pytest.raises(FMICallException):
        instance.fmu.setFMUState(None)
    assert "no state was saved" in instance.messages[-1]
    assert instance.fmu.serializeFMUState(instance.fmu.getFMUState()) == good
