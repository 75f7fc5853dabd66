"""An effect with a state of its own, added as docs/dev/extending/effect.md says, is found."""

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from search_rigs.hypotheses import against, fit_set, nothing_of

from twin.effects import EFFECTS, Block, Effect, EffectParameter
from twin.effects.stages import ImuReading, Thrust
from twin.explain.model.model import Model, model_of
from twin.explain.model.prediction import states_reached
from twin.logs import Flight
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
from twin.residuals.teacher_forced import integrate_states
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
WAYPOINTS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -2.0)),
    ("tour", 2.0, (3.0, 0.0, -2.0)),
    ("tour", 2.0, (3.0, 3.0, -4.0)),
    ("tour", 2.0, (0.0, 0.0, -2.0)),
    ("hover", 4.0, (0.0, 0.0, -2.0)),
)


def _heat_droop(r: Thrust, p: Block) -> Thrust:
    """Motors warm up with the square of their speed, and give less thrust then."""
    weaker = []
    for n, (thrust, spin) in enumerate(zip(r.thrust, r.spin, strict=True), start=1):
        warmth = p.state(f"warmth_{n}", "1", f"warmth of motor {n} over that of a long hover")
        p.derivative(f"warmth_{n}", (spin * spin - warmth) / p["tau_s"])
        weaker.append(thrust * (1 - p["droop"] * warmth))
    return replace(r, thrust=weaker)


def _warming_gyro(r: ImuReading, p: Block) -> ImuReading:
    """The gyroscope drifts as it warms up: memory of a sensor, changed at its sample instants."""
    cold = p.memory("cold", "1", "how cold it still is", 1.0)
    p.update("cold", cold * (1 - 1e-3 / p["tau_s"]))
    return replace(r, gyro=[r.gyro[0] + p["drift_rad_s"] * (1 - cold), *r.gyro[1:]])


HEAT_DROOP = Effect(
    "heat_droop",
    "motors lose thrust as they warm up",
    "airframe",
    Thrust,
    (
        EffectParameter("droop", "1", "share of the thrust lost in a long hover", 0.15, (0, 0.5)),
        EffectParameter("tau_s", "s", "time constant of the motor", 4.0, (1, 30), neutral=None),
    ),
    ("acc",),
    "made up for this test",
    _heat_droop,
    prior=None,
    change=None,
    wording=None,
    advice=None,
)
WARMING_GYRO = Effect(
    "warming_gyro",
    "the gyroscope drifts as it warms up",
    "imu",
    ImuReading,
    (
        EffectParameter("drift_rad_s", "rad/s", "drift once it is warm", 0.05, (-0.3, 0.3)),
        EffectParameter("tau_s", "s", "time constant", 3.0, (0.5, 30), neutral=None),
    ),
    ("gyro", "q"),
    "made up for this test",
    _warming_gyro,
    prior=None,
    change=None,
    wording=None,
    advice=None,
)
RIVALS = {
    "airframe": ("thrust_scale", "mass_offset", "accel_scale"),
    "imu": ("gyro_bias", "gyro_scale", "cog_offset"),
}
"""By where an effect acts, what else its sensors might show."""


@pytest.fixture(params=[HEAT_DROOP, WARMING_GYRO], ids=lambda e: e.name)
def added(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Effect]:
    """The library with one more effect: as if it stood in the list at the end of its module."""
    effect: Effect = request.param
    monkeypatch.setitem(EFFECTS, effect.name, effect)
    yield effect


def flown(plant: Vehicle) -> Flight:
    return fly(COPTER, plant, 5, waypoints=WAYPOINTS)


def planted(effect: Effect) -> Vehicle:
    return COPTER.with_effects({effect.name: effect.starts(COPTER)})


@pytest.mark.slow
def test_a_new_effect_with_a_state_is_the_best_explanation(added: Effect) -> None:
    flight = flown(planted(added))
    rivals = RIVALS[added.component]
    problem = against(flight, COPTER, added.name, *rivals)
    nothing = nothing_of(problem)
    found = fit_set(problem, [added.name], nothing)
    for rival in rivals:
        assert found.gain > fit_set(problem, [rival], nothing).gain + 5, rival
    size = added.parameters[0]
    value = found.values[f"{added.name}.{size.name}"]
    assert value == pytest.approx(size.start, rel=0.25)
    tau = found.values[f"{added.name}.tau_s"]
    assert tau == pytest.approx(added.parameters[1].start, rel=0.5)


def slope_error(model: Model, name: str, values: dict[str, float]) -> float:
    """Largest deviation of the slopes by a number from a central difference, over their size."""
    i = next(i for i, n in enumerate(model.numbers) if n.full == name)
    step = 0.1 * model.numbers[i].step
    here = {**values, name: values.get(name, model.numbers[i].now)}
    (rows,) = model.channels([i], here)
    (up,), (down,) = (
        model.channels([], {**here, name: here[name] + sign * step}) for sign in (1, -1)
    )
    worst = size = 0.0
    for c, u, d in zip(rows, up, down, strict=True):
        numeric = (d.residual - u.residual) / (2 * step)
        worst = max(worst, float(np.max(np.abs(c.slopes[:, 0] - numeric))))
        size = max(size, float(np.max(np.abs(numeric))))
    assert size > 0, f"{name} changes nothing"
    return worst / size


@pytest.mark.slow
def test_slopes_of_an_effect_with_a_state_are_differences_of_predictions(added: Effect) -> None:
    model = model_of([flown(COPTER)], COPTER, [added, EFFECTS["thrust_scale"]])
    size, tau = (f"{added.name}.{p.name}" for p in added.parameters)
    assert slope_error(model, size, {}) < 0.01
    values = {size: added.parameters[0].start, tau: 3.0}
    assert slope_error(model, size, values) < 0.01
    if added is HEAT_DROOP:
        assert slope_error(model, "thrust_scale.scale", values) < 0.02


def test_states_integrated_along_a_motion_are_those_of_the_equation() -> None:
    """First-order response to a spin that steps: 1 - exp(-t / tau), warmth after warmth."""
    known = {**EFFECTS}
    EFFECTS[HEAT_DROOP.name] = HEAT_DROOP
    try:
        body = airframe(COPTER, effects=[HEAT_DROOP.name])
    finally:
        EFFECTS.pop(HEAT_DROOP.name)
    assert known == EFFECTS
    index = [i for i, s in enumerate(body.states) if s.name.startswith("heat_droop.")]
    reached = states_reached(body, index)
    assert reached["heat_droop.tau_s"] == frozenset(index)
    assert "heat_droop.droop" not in reached and "drag.linear_x" not in reached
    p = body.parameter_values({"heat_droop.enabled": 1.0, "heat_droop.tau_s": 2.0})
    u = np.tile(body.input_values(), (2001, 1))
    x = np.tile(np.asarray(body.initial(u[0], p)).ravel(), (2001, 1))
    x[400:500] = np.nan  # unknown for a while: the last known motion counts
    warmth = integrate_states(body, index, x, u, p, 0.005)
    t = 0.005 * np.arange(2001)
    y = np.asarray(body.outputs(x[0], u[0], p)).ravel()
    spins = y[[body.output_names.index(f"spin_{i}") for i in range(1, 5)]]
    expected = (1 - np.exp(-t / 2.0))[:, None] * spins**2
    np.testing.assert_allclose(warmth, expected, atol=1e-9)


def test_memory_is_integrated_at_its_own_sample_instants() -> None:
    EFFECTS[WARMING_GYRO.name] = WARMING_GYRO
    try:
        sensor = imu(COPTER, [WARMING_GYRO.name])
    finally:
        EFFECTS.pop(WARMING_GYRO.name)
    (index,) = (i for i, s in enumerate(sensor.states) if s.name == "warming_gyro.cold")
    p = sensor.parameter_values({"warming_gyro.enabled": 1.0, "warming_gyro.tau_s": 2.0})
    u = np.tile(sensor.input_values(), (201, 1))
    x = np.zeros((201, len(sensor.states)))
    cold = integrate_states(sensor, [index], x, u, p, 0.005)[:, 0]
    expected = (1 - 1e-3 / 2.0) ** (5 * np.arange(201) + 1)
    np.testing.assert_allclose(cold, expected, rtol=1e-12)
    assert ca.DM(states_reached(sensor, [index])["warming_gyro.tau_s"] == {index})
