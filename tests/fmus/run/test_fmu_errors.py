"""What an FMU says when it is used wrongly: by its logger, with the name and the value."""

import math
from collections.abc import Callable

import pytest
from fmpy.fmi1 import FMICallException
from instance import Instance

New = Callable[[str, int], Instance]
pytestmark = pytest.mark.parametrize("fmi", [2, 3])


def refused(instance: Instance, call: Callable[[], object]) -> str:
    """The only message of a call that must fail."""
    instance.messages.clear()
    with pytest.raises(FMICallException):
        call()
    (message,) = instance.messages
    return message


@pytest.mark.parametrize("step", [0.0, -1e-3, math.nan, math.inf, -math.inf])
def test_step_size(new: New, fmi: int, step: float) -> None:
    instance = new("airframe-copter_default", fmi).start()
    before = instance.outputs().tobytes()
    message = refused(instance, lambda: instance.step(0.0, step))
    assert message == f"communication step size {step:g} s must be positive"
    assert instance.outputs().tobytes() == before
    instance.step(0.0)  # still usable


def test_step_that_would_never_end(new: New, fmi: int) -> None:
    instance = new("battery", fmi).start()
    assert "1e+09 s is too long" in refused(instance, lambda: instance.step(0.0, 1e9))


@pytest.mark.parametrize("time", [-1e-3, 0.5, math.nan, math.inf])
def test_step_from_another_time(new: New, fmi: int, time: float) -> None:
    instance = new("airframe-copter_default", fmi).start()
    instance.step(0.0)
    message = refused(instance, lambda: instance.step(time))
    assert message == f"doStep at {time:.9g} s, but the FMU is at 0.001 s"


def test_step_from_a_time_with_rounding_errors(new: New, fmi: int) -> None:
    instance, time = new("battery", fmi).start(), 0.0
    for _ in range(3000):
        instance.step(time)
        time += 1e-3
    assert time != 3.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_input_that_is_no_number(new: New, fmi: int, value: float) -> None:
    instance = new("airframe-copter_default", fmi).start()
    instance.step(0.0)
    before = instance.outputs().tobytes()
    message = refused(instance, lambda: instance.set({"cmd_2": value}))
    assert message == f"cmd_2 = {value:g} at time 0.001 s is not a finite number"
    assert instance.outputs().tobytes() == before


def test_parameter_out_of_range(new: New, fmi: int) -> None:
    instance = new("airframe-copter_default", fmi)
    low = refused(instance, lambda: instance.set({"mass": -1.0}))
    assert low == "mass = -1 is below its minimum 0.0001"
    instance = new("battery", fmi)
    high = refused(instance, lambda: instance.set({"initial.charge": 1.5}))
    assert high == "initial.charge = 1.5 is above its maximum 1"
    assert instance.start().get("charge") == 1.0


def test_fixed_parameter_after_initialisation(new: New, fmi: int) -> None:
    instance = new("airframe-copter_default", fmi)
    instance.enter()
    instance.set({"initial.pos_x": 3.0})
    instance.leave()
    assert instance.get("pos_x") == 3.0
    message = refused(instance, lambda: instance.set({"initial.pos_x": 4.0}))
    assert message == "initial.pos_x is fixed once initialization has ended; reset the FMU first"
    instance.set({"mass": 1.5})  # a tunable one may change


def test_output_cannot_be_set(new: New, fmi: int) -> None:
    instance = new("airframe-copter_default", fmi).start()
    message = refused(instance, lambda: instance.set({"pos_x": 1.0}))
    assert message == "pos_x is computed and cannot be set"


def test_unknown_value_reference(new: New, fmi: int) -> None:
    instance = new("battery", fmi).start()
    suffix = "Real" if fmi == 2 else "Float64"
    get = getattr(instance.fmu, f"get{suffix}")
    assert "value reference 9999" in refused(instance, lambda: get([9999]))


def test_calls_out_of_order(new: New, fmi: int) -> None:
    """The whole table is in `test_calling_sequence`; these are the words."""
    instance = new("battery", fmi)
    before = "a step cannot be made before initialization"
    assert refused(instance, lambda: instance.step(0.0)) == before
    assert refused(instance, instance.leave) == "initialization cannot be ended " + before[-21:]
    assert "terminated before initialization" in refused(instance, instance.fmu.terminate)
    instance.enter()
    assert "in initialization mode" in refused(instance, lambda: instance.step(0.0))
    assert "cannot be set in initialization mode" in refused(instance, instance.enter)
    instance.leave()
    instance.step(0.0)
    instance.fmu.terminate()
    after = "a step cannot be made after terminate; reset the FMU first"
    assert refused(instance, lambda: instance.step(1e-3)) == after
    instance.fmu.reset()
    instance.start(time_s=5.0).step(5.0)


def test_start_time_that_is_no_number(new: New, fmi: int) -> None:
    instance = new("battery", fmi)
    assert "start time nan is not finite" in refused(
        instance, lambda: instance.enter(time_s=math.nan)
    )


def test_divergence_stops_with_state_and_time(new: New, fmi: int) -> None:
    instance = new("airframe-copter_default", fmi).start({"initial.omega_x": 1e160})
    message = refused(instance, lambda: instance.step(0.0))
    assert message.startswith("state pos_x = ")
    assert message.endswith("nan at time 0.001 s: the simulation has diverged")


def test_reset_forgets_everything(new: New, fmi: int) -> None:
    fresh, used = new("airframe-copter_default", fmi), new("airframe-copter_default", fmi)
    used.start({"mass": 2.0, "wind_x": 3.0, "initial.omega_x": 1.0}).run(20)
    used.fmu.reset()
    assert used.start().run(5).tobytes() == fresh.start().run(5).tobytes()


def test_events_are_told_to_who_asks(new: New, fmi: int) -> None:
    """Category logEvents: off by itself, on for as long as it is wanted."""
    instance = new("battery", fmi)
    instance.start()
    assert instance.messages == []
    instance.fmu.setDebugLogging(True, ["logEvents"])
    saved = instance.fmu.getFMUState()
    instance.step(0.0, 0.25)
    instance.fmu.setFMUState(saved)
    instance.fmu.freeFMUState(saved)
    instance.fmu.reset()
    instance.start(time_s=2.0)
    instance.fmu.setDebugLogging(False, ["logEvents"])
    instance.fmu.terminate()
    assert instance.messages == [
        "restored a state, now at 0 s",
        "reset, now at 0 s",
        "initialized at 2 s",
    ]
    with pytest.raises(FMICallException):
        instance.fmu.setDebugLogging(True, ["logDreams"])
    assert instance.messages[-1] == "there is no such log category"
