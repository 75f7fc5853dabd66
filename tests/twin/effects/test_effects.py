"""The effect library: off is exactly absent, on is what the definition says."""

from importlib import resources

import numpy as np
import pytest
from rig import BUILTIN, Rig, plain, q, vec, with_rotors

from twin.effects import EFFECTS, Effect, effects_of
from twin.errors import ModelError
from twin.flight.control_laws import linearise
from twin.physics.airframe import airframe
from twin.physics.rotors import SHORTEST_LAG_S
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle, parse_vehicle

AIRFRAME = effects_of("airframe")
IDS = [e.name for e in AIRFRAME]
FLYING = (
    vec("vel", [4.0, -2.0, -1.0])
    | vec("omega", [0.3, -0.5, 0.8])
    | q(np.array([0.9, 0.2, -0.3, 0.1]) / np.linalg.norm([0.9, 0.2, -0.3, 0.1]))
)


def lacking(vehicle: Vehicle) -> Rig:
    return Rig(airframe(vehicle, effects=()), {"ground.enabled": 0.0})


def having(vehicle: Vehicle, effect: str, **numbers: float) -> Rig:
    """The airframe with one effect on, its numbers set, in mid-air."""
    settings = {f"{effect}.{k}": v for k, v in numbers.items()} | {f"{effect}.enabled": 1.0}
    return Rig(airframe(vehicle, effects=[effect]), {"ground.enabled": 0.0, **settings})


def change(
    vehicle: Vehicle, effect: str, state: dict[str, float], **numbers: float
) -> dict[str, float]:
    """What the effect adds to the rates, at the same state and inputs."""
    with_it, without = having(vehicle, effect, **numbers), lacking(vehicle)
    u = without.inputs(vec("wind", [0, 0, 0]))
    base = without.rates(without.state(state), u)
    rates = with_it.rates(
        with_it.state(state),
        with_it.inputs(dict(zip(without.component.input_names, u, strict=True))),
    )
    return {name: rates[name] - value for name, value in base.items()}


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", [load_vehicle(n) for n in BUILTIN], ids=BUILTIN)
def test_an_airframe_with_all_effects_off_is_the_one_without_to_the_last_bit(
    vehicle: Vehicle,
) -> None:
    full, bare = Rig(airframe(vehicle, effects=EFFECTS)), Rig(airframe(vehicle))
    u_full, u_bare = full.inputs(), bare.inputs()
    x_full = full.state(FLYING | {"pos_z": -3.0})
    x_bare = bare.state(FLYING | {"pos_z": -3.0})
    for _ in range(200):
        x_full = full.component.advance(x_full, u_full, full.p, 1e-3)
        x_bare = bare.component.advance(x_bare, u_bare, bare.p, 1e-3)
        for shortcut in full.component.shortcuts:
            if float(shortcut.holds(x_full, full.p, 1e-3)):
                cheap = np.asarray(shortcut.step(x_full, u_full, full.p, 1e-3)).ravel()
                whole = np.asarray(full.component.step(x_full, u_full, full.p, 1e-3)).ravel()
                np.testing.assert_array_equal(cheap, whole)
    ours = dict(zip(full.names, x_full, strict=True))
    assert [ours[n] for n in bare.names] == x_bare.tolist()
    y_full, y_bare = full.outputs(x_full, u_full), bare.outputs(x_bare, u_bare)
    assert {n: y_full[n] for n in y_bare} == y_bare


@pytest.mark.slow
@pytest.mark.parametrize("effect", AIRFRAME, ids=IDS)
def test_an_effect_at_its_neutral_value_changes_nothing(effect: Effect) -> None:
    vehicle = plain()
    neutral = {
        n: p.neutral
        for p in (p.sized(vehicle) for p in effect.parameters)
        for n in p.names(vehicle)
        if p.neutral is not None
    }
    for rate in change(vehicle, effect.name, FLYING, **neutral).values():
        assert rate == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("effect", AIRFRAME, ids=IDS)
def test_an_effect_at_its_start_value_is_felt_and_stays_finite(effect: Effect) -> None:
    vehicle = plain(drag_linear_n_s_m=np.array([0.1, 0.1, 0.0]))
    rig = having(vehicle, effect.name)
    bare = lacking(vehicle)
    names = dict(zip(bare.component.input_names, bare.inputs(), strict=True))
    changes = {"vbat_v": 3.4, "density": 1.1} | {"cmd_1": 0.5, "cmd_2": 0.3}
    known = {k: v for k, v in (names | changes).items() if k in rig.component.input_names}
    x = rig.state(FLYING | {"pos_z": -0.3})
    off = Rig(rig.component, {"ground.enabled": 0.0})
    moved = rig.fly(x, rig.inputs(known), 0.5)[-1] - off.fly(x, off.inputs(known), 0.5)[-1]
    assert np.all(np.isfinite(moved))
    if effect.name != "rotor_efficiency_loss":  # whose middling size is: no rotor is damaged
        assert np.abs(moved).max() > 1e-4


def test_prior_ranges_hold_the_start_value_and_the_neutral_one() -> None:
    for effect in EFFECTS.values():
        for p in effect.parameters:
            assert p.bounds[0] <= p.start <= p.bounds[1], (effect.name, p.name)
            if p.neutral is not None:
                assert p.bounds[0] <= p.neutral <= p.bounds[1], (effect.name, p.name)


def test_a_vehicle_as_it_stands_keeps_the_limits_of_every_effect() -> None:
    for vehicle in map(load_vehicle, BUILTIN):
        for effect in EFFECTS.values():
            neutral = {
                n: p.neutral
                for p in effect.parameters
                for n in p.names(vehicle)
                if p.neutral is not None
            }
            for limit in effect.limits(vehicle):
                assert sum(w * neutral[k] for k, w in limit.weights.items()) >= 0, effect.name


def test_ranges_hold_what_real_flights_have_shown() -> None:
    """2,140 Pa off in RflySimDT's logs: the pressure of the day; 86 uT indoors, by its motors."""
    assert EFFECTS["baro_bias"].parameters[0].bounds[0] < -2140
    assert all(p.bounds[1] > 1.5 * 86e-6 for p in EFFECTS["mag_hard_iron"].parameters)


# -- exact answers --------------------------------------------------------------------------


def test_rotor_drag_slows_in_proportion_to_the_speed() -> None:
    added = change(plain(), "rotor_drag", vec("vel", [4, -2, -1]), k_xy_1_s=0.3, k_z_1_s=0.1)
    assert [added[f"vel_{a}"] for a in "xyz"] == pytest.approx([-1.2, 0.6, 0.1])


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.6])
@pytest.mark.parametrize("faster", [1.0, 1.3])
def test_rotor_drag_is_that_of_the_hover_of_the_aircraft(scale: float, faster: float) -> None:
    """Whatever a file says of thrust: rotor speed goes with the root of thrust over weight."""
    vehicle = load_vehicle("crazyflie").with_effects({"thrust_scale": {"scale": scale}})
    rig = having(vehicle, "rotor_drag", k_xy_1_s=0.3, k_z_1_s=0.0, spin_share=0.6)
    still = rig.state()
    still[[n.startswith(("rotor_", "effort_")) for n in rig.names]] *= faster
    moving = still.copy()
    moving[rig.names.index("vel_x")] = 1.0
    rest, flown = (rig.outputs(x, rig.inputs()) for x in (still, moving))
    speed = np.sqrt(-rest["specific_force_z"] / vehicle.gravity_m_s2)
    assert faster == 1.0 or speed > 1.1
    drag = flown["specific_force_x"] - rest["specific_force_x"]
    assert drag == pytest.approx(-0.3 * (1 + 0.6 * (speed - 1)))


def test_rotor_drag_that_attacks_above_the_hubs_lifts_the_nose() -> None:
    added = change(
        plain(), "rotor_drag", vec("vel", [4, -2, 0]), k_xy_1_s=0.3, k_z_1_s=0.0, height_m=0.05
    )
    assert added["omega_y"] == pytest.approx(0.05 * 1.2 * 0.3 * 4 / 0.027)
    assert added["omega_x"] == pytest.approx(0.05 * 1.2 * 0.3 * 2 / 0.020)
    assert added["vel_x"] == pytest.approx(-1.2)


@pytest.mark.slow
def test_a_centre_of_mass_below_the_hubs_is_pulled_nose_up_by_their_drag() -> None:
    dragged = plain().with_effects({"rotor_drag": {"k_xy_1_s": 0.3, "k_z_1_s": 0.0}})
    forward = vec("vel", [4, 0, 0])
    added = change(dragged, "cog_offset", forward, x_m=0.0, z_m=0.02)
    assert added["omega_y"] == pytest.approx(0.02 * 1.2 * 0.3 * 4 / 0.027)
    # Where the file has the centre of mass, above that of the aircraft, as the nose goes up.
    rig, bare = having(dragged, "cog_offset", x_m=0.0, z_m=0.02), lacking(dragged)
    felt, there = (r.outputs(r.state(forward), r.inputs()) for r in (rig, bare))
    assert felt["specific_force_x"] - there["specific_force_x"] == pytest.approx(
        -0.02 * added["omega_y"]
    )


def test_parasitic_drag_slows_with_the_square_of_the_speed() -> None:
    added = change(plain(), "parasitic_drag", vec("vel", [3, 4, 0]), c_1_m=0.02)
    assert [added[f"vel_{a}"] for a in "xyz"] == pytest.approx([-0.3, -0.4, 0.0])


@pytest.mark.slow
def test_wind_acts_through_drag_alone() -> None:
    still = having(plain(), "steady_wind", north_m_s=5.0)
    assert np.allclose(list(still.rates(still.state(), still.inputs()).values()), 0.0)
    vehicle = plain(drag_linear_n_s_m=np.array([0.12, 0.12, 0.0]))
    added = change(vehicle, "steady_wind", {}, north_m_s=5.0, east_m_s=-1.0)
    assert [added["vel_x"], added["vel_y"]] == pytest.approx([0.5, -0.1])


def test_inflow_takes_thrust_in_a_climb() -> None:
    added = change(plain(), "induced_inflow", vec("vel", [0, 0, -2]), k_s_m=0.05)
    assert added["vel_z"] == pytest.approx(0.1 * 9.80665)


def test_translational_lift_is_glauerts_inflow() -> None:
    v0, v = 4.0, 6.0
    added = change(plain(), "translational_lift", vec("vel", [v, 0, 0]), gain=0.3, induced_m_s=v0)
    inflow = -added["vel_z"] / 9.80665 / 0.3  # 1 - w / v0
    w = (1 - inflow) * v0
    assert w * np.hypot(v, w) == pytest.approx(v0**2)


def test_blade_flapping_pulls_back_and_pitches_up() -> None:
    added = change(plain(), "blade_flapping", vec("vel", [5, 0, 0]), k_rad_s_m=0.02, height_m=0.04)
    assert added["vel_x"] == pytest.approx(-0.1 * 9.80665)
    assert added["omega_y"] == pytest.approx(0.04 * 0.1 * 1.2 * 9.80665 / 0.027)


@pytest.mark.slow
def test_ground_effect_lifts_and_fades_with_the_square_of_the_height() -> None:
    def gained(height: float) -> float:
        lift = change(plain(), "ground_effect", {"pos_z": -height}, gain=0.3, height_m=0.4)
        return -lift["vel_z"] / 9.80665

    assert gained(0.4) == pytest.approx(0.15)
    assert gained(40.0) / gained(80.0) == pytest.approx(4.0, rel=1e-3)
    assert gained(0.01) == gained(0.1)


@pytest.mark.slow
def test_thrust_scale_and_curve() -> None:
    assert change(plain(), "thrust_scale", {}, scale=0.9)["vel_z"] == pytest.approx(0.980665)
    assert change(plain(), "thrust_curve", {}, slope=0.5)["vel_z"] == pytest.approx(0.0, abs=1e-12)
    vehicle = plain()
    rig = having(vehicle, "thrust_curve", slope=0.5)
    efforts = {f"effort_{i}": 1.2 * vehicle.hover_thrust_n / 8.0 for i in range(1, 5)}
    rate = rig.rates(rig.state(efforts), rig.inputs())["vel_z"]
    assert rate == pytest.approx(9.80665 * (1 - 1.2**1.5))


def test_more_command_never_lifts_less() -> None:
    """Where the curve is nearly as flat as it may be, far beyond hover."""
    rig = having(plain(), "thrust_curve", slope=-0.95)
    sink = [
        rig.rates(rig.state({f"effort_{i}": e for i in range(1, 5)}), rig.inputs())["vel_z"]
        for e in (0.0, 0.3, 0.6, 1.0)
    ]
    assert np.all(np.diff(sink) < 0)


def test_battery_sag_scales_thrust_and_torque() -> None:
    vehicle = plain()
    rig = having(vehicle, "battery_sag", slope=2.0, reference_v=12.0)
    rate = rig.rates(rig.state(), rig.inputs(vbat_v=11.4))["vel_z"]
    assert rate == pytest.approx(0.1 * 9.80665)


@pytest.mark.parametrize("own_s", [0.0, 0.04])
def test_motor_lag_adds_to_the_models_own(own_s: float) -> None:
    vehicle = with_rotors(plain(), lag_up_s=own_s, lag_down_s=own_s)
    rig = having(vehicle, "motor_lag", tau_s=0.05)
    trim = rig.inputs()[0]
    x = rig.fly(rig.state(), rig.commands([0.8] * 4), 0.1)[-1]
    level = rig.get(x, "effort_1")[0]
    assert (0.8 - level) / (0.8 - trim) == pytest.approx(np.exp(-0.1 / (own_s + 0.05)), rel=1e-6)


@pytest.mark.parametrize("tau_s", [0.0, 0.003])
def test_a_lag_that_is_short_is_as_late_as_it_says(tau_s: float) -> None:
    """On a ramp a first-order lag follows tau behind, once its start has died out."""
    rig = having(with_rotors(plain(), lag_up_s=0.0, lag_down_s=0.0), "motor_lag", tau_s=tau_s)
    x, slope = rig.state(), 0.5
    commands = rig.inputs()[0] + slope * 1e-3 * np.arange(200)
    for command in commands[:-1]:  # held over a step: half of it late by itself
        x = rig.component.advance(x, rig.commands([command] * 4), rig.p, 1e-3)
    thrust = rig.outputs(x, rig.commands([commands[-1]] * 4))["thrust_1"]
    late_s = tau_s + 0.5e-3 * min(tau_s / SHORTEST_LAG_S, 1)
    assert thrust == pytest.approx(8.0 * (commands[-1] - slope * late_s), abs=8.0 * slope * 1e-5)


@pytest.mark.slow
def test_a_lag_of_the_file_can_be_shortened() -> None:
    vehicle = plain()
    tau = EFFECTS["motor_lag"].parameters[0].sized(vehicle)
    assert tau.bounds == pytest.approx((-0.036, 0.3))
    for tau_s, left_s in ((-0.02, 0.02), (-0.036, 0.004), (-0.2, 0.0025)):
        rig = having(vehicle, "motor_lag", tau_s=tau_s)
        trim = rig.inputs()[0]
        level = rig.get(rig.fly(rig.state(), rig.commands([0.8] * 4), 0.01)[-1], "effort_1")[0]
        assert (0.8 - level) / (0.8 - trim) == pytest.approx(np.exp(-0.01 / left_s), rel=2e-3)
    for instant in ({"lag_up_s": 0.0, "lag_down_s": 0.0}, {"lag_up_s": 1e-3, "lag_down_s": 1e-3}):
        sized = EFFECTS["motor_lag"].parameters[0].sized(with_rotors(vehicle, **instant))
        assert sized.bounds == (0.0, 0.3)


@pytest.mark.slow
def test_a_weak_rotor_drops_its_corner() -> None:
    added = change(plain(), "rotor_efficiency_loss", {}, loss_1=0.1)  # front right
    push = 0.1 * 1.2 * 9.80665 / 4
    assert added["vel_z"] == pytest.approx(push / 1.2)
    assert added["omega_x"] == pytest.approx(0.16 * push / 0.020)
    assert added["omega_y"] == pytest.approx(-0.16 * push / 0.027)


@pytest.mark.parametrize("share", [0.0, 1.0, 1.4])
def test_a_weak_rotor_loses_reaction_torque_as_well(share: float) -> None:
    added = change(plain(), "rotor_efficiency_loss", {}, loss_2=0.1, torque_share=share)
    torque = 0.02 * 1.2 * 9.80665 / 4  # of a rotor that turns counter-clockwise: the body's is +
    assert added["omega_z"] == pytest.approx((0.9**share - 1) * torque / 0.036)
    assert added["vel_z"] == pytest.approx(0.1 * 9.80665 / 4)


@pytest.mark.parametrize("share", [0.0, 0.7, 1.5])
def test_a_weak_rotor_never_twists_the_other_way(share: float) -> None:
    """At a small loss it loses `share` of its torque per share of its thrust, at any loss it keeps
    some: a rotor that has lost all of its torque leaves no authority in yaw."""
    torque = 0.02 * 1.2 * 9.80665 / 4 / 0.036

    def lost(loss: float) -> float:
        """Share of its reaction torque."""
        added = change(plain(), "rotor_efficiency_loss", {}, loss_2=loss, torque_share=share)
        return -added["omega_z"] / torque

    assert lost(1e-4) == pytest.approx(1e-4 * share, rel=1e-3, abs=1e-9)
    some = [lost(loss) for loss in (-0.3, 0.0, 0.3, 0.65, 0.9, 1.0)]
    assert np.all(np.diff(some) >= 0)
    assert max(some) < 1.0


@pytest.mark.parametrize("at_speed", [False, True])
def test_rotors_without_a_lag_twist_as_they_speed_up(at_speed: bool) -> None:
    """The turn of the body is that of the change of their momentum, however fast that was."""
    base = load_vehicle("copter_default") if at_speed else plain()
    vehicle = with_rotors(base, lag_up_s=0.0, lag_down_s=0.0)
    momentum = 0.01 * vehicle.inertia_kg_m2[2, 2]
    runs = []
    for rig in (
        having(vehicle, "rotor_inertia_torque", momentum_n_m_s=momentum),
        lacking(vehicle),
    ):
        trim = rig.inputs()[:4]
        way = np.array(vehicle.rotors.direction)
        x = rig.fly(rig.state(), rig.commands((trim + 0.02 * way).tolist()), 0.1)[-1]
        runs.append(rig.get(x, "omega_z")[0])
        spins = [rig.outputs(x, rig.commands((trim + s * 0.02 * way).tolist())) for s in (1, 0)]
    gained = sum(
        d * (spins[0][f"spin_{i}"] - spins[1][f"spin_{i}"])
        for i, d in enumerate(vehicle.rotors.direction, start=1)
    )
    assert runs[0] - runs[1] == pytest.approx(-0.01 * gained, rel=2e-3)


@pytest.mark.slow
def test_a_controller_is_designed_for_settled_rotors() -> None:
    """Whatever torque they have on the way, and whether they have a lag."""
    for lag_s in (0.0, 0.04):
        vehicle = with_rotors(plain(), lag_up_s=lag_s, lag_down_s=lag_s)
        twisting = vehicle.with_effects({"rotor_inertia_torque": {"momentum_n_m_s": 0.01}})
        bare, found = linearise(vehicle), linearise(twisting)
        np.testing.assert_allclose(found.effect, bare.effect, rtol=1e-9, atol=1e-9)
        assert found.lag_s == pytest.approx(bare.lag_s) == pytest.approx(lag_s)


def test_spinning_up_twists_against_the_rotor() -> None:
    vehicle = plain()
    rig, bare = having(vehicle, "rotor_inertia_torque", momentum_n_m_s=0.01), lacking(vehicle)
    u = rig.commands([0.9, 0.9, 0.2, 0.2])
    got = (
        rig.rates(rig.state(), u)["omega_z"]
        - bare.rates(bare.state(), bare.commands([0.9, 0.9, 0.2, 0.2]))["omega_z"]
    )
    trim = bare.inputs()[0]
    # spin = sqrt(effort / trim): its rate is effort' / (2 trim) in hover.
    spin_rate = [(c - trim) / 0.04 / (2 * trim) for c in (0.9, 0.9, 0.2, 0.2)]
    torque = -sum(d * 0.01 * s for d, s in zip(vehicle.rotors.direction, spin_rate, strict=True))
    assert got == pytest.approx(torque / 0.036)


def test_spinning_rotors_turn_a_roll_rate_into_a_pitch_torque() -> None:
    vehicle = plain()
    rig, bare = having(vehicle, "gyroscopic_torque", momentum_n_m_s=0.01), lacking(vehicle)
    # The two rotors that turn counter-clockwise, seen from above, alone.
    state = {"effort_1": 0.5, "effort_2": 0.5, "effort_3": 0.0, "effort_4": 0.0}
    state |= vec("omega", [2, 0, 0])
    with_it, without = (r.rates(r.state(state), r.inputs()) for r in (rig, bare))
    spin = np.sqrt(0.5 * 8.0 / vehicle.hover_thrust_n)
    # - omega x H with H = -2 J spin e_z
    assert with_it["omega_y"] - without["omega_y"] == pytest.approx(-2 * 2 * 0.01 * spin / 0.027)
    assert with_it["omega_x"] == pytest.approx(without["omega_x"])


def test_yaw_torque_scale() -> None:
    rig = having(plain(), "yaw_torque_scale", scale=2.0)
    bare = lacking(plain())
    state = {"effort_1": 0.5, "effort_2": 0.5, "effort_3": 0.2, "effort_4": 0.2}
    double, single = (r.rates(r.state(state), r.inputs())["omega_z"] for r in (rig, bare))
    assert double == pytest.approx(2 * single)


def test_tilted_thrust_keeps_its_size() -> None:
    added = change(plain(), "thrust_tilt", {}, x_rad=0.05, y_rad=-0.02)
    force = np.array([added[f"vel_{a}"] for a in "xyz"]) - [0, 0, 9.80665]
    assert force[0] == pytest.approx(0.05 * 9.80665)
    assert np.linalg.norm(force) == pytest.approx(9.80665)


@pytest.mark.slow
def test_mass_centre_and_inertia() -> None:
    heavier = change(plain(), "mass_offset", {}, mass_kg=0.12)
    assert heavier["vel_z"] == pytest.approx(9.80665 * (1 - 1 / 1.1))
    ahead = change(plain(), "cog_offset", {}, x_m=0.01)  # nose-heavy: pitches down
    assert ahead["omega_y"] == pytest.approx(-0.01 * 1.2 * 9.80665 / 0.027)
    level = change(plain(), "cog_offset", {}, x_m=0.0, z_m=0.02)
    assert level["omega_y"] == pytest.approx(0.0, abs=1e-12)
    rig, bare = having(plain(), "inertia_error", scale_x=2.0), lacking(plain())
    state = {"effort_1": 0.5, "effort_2": 0.2, "effort_3": 0.2, "effort_4": 0.5}
    slow, fast = (r.rates(r.state(state), r.inputs())["omega_x"] for r in (rig, bare))
    assert slow == pytest.approx(fast / 2)


def test_a_slung_load_weighs_what_it_weighs_and_swings_as_a_pendulum() -> None:
    vehicle = plain(mass_kg=1000.0, rotors=plain().rotors)
    vehicle = with_rotors(vehicle, thrust_n=(0.0, 8000.0), torque_n_m=(0.0, 0.0))
    rig = having(vehicle, "slung_load", mass_kg=0.1, length_m=1.0)
    at_rest = rig.rates(rig.state(), rig.inputs())
    assert at_rest["vel_z"] == pytest.approx(0.1 * 9.80665 / 1000.0)
    assert at_rest["slung_load.v_z"] == pytest.approx(0.0, abs=1e-9)
    x = rig.fly(rig.state({"slung_load.r_x": 0.05}), rig.inputs(), 10.0)
    swing = rig.get(x, "slung_load.r_x")[:, 0]
    crossings = np.nonzero((swing[:-1] > 0) & (swing[1:] <= 0))[0]
    stretched = 1.0 + 9.80665 / (2 * np.pi * 5.0) ** 2
    assert np.diff(crossings).mean() * 1e-3 == pytest.approx(
        2 * np.pi * np.sqrt(stretched / 9.80665), rel=0.01
    )


# -- settings -------------------------------------------------------------------------------


RIGHT = """
[effects.rotor_drag]
k_xy_1_s = { value = 30, unit = "1/minute", source = "made up" }
"""


def with_text(more: str) -> Vehicle:
    text = (resources.files("twin.vehicle") / "built_in" / "copter_default.toml").read_text()
    return parse_vehicle(text + more, "mine.toml")


def test_a_vehicle_file_switches_effects_on() -> None:
    vehicle = with_text(RIGHT)
    assert vehicle.effects == {
        "rotor_drag": EFFECTS["rotor_drag"].starts(vehicle) | {"k_xy_1_s": 0.5}
    }
    assert vehicle.sources["effects.rotor_drag.k_xy_1_s"] == "made up"
    starts = {v.name: v.start for v in airframe(vehicle).parameters}
    assert (starts["rotor_drag.enabled"], starts["rotor_drag.k_xy_1_s"]) == (1.0, 0.5)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (RIGHT.replace("rotor_drag", "rotor_drug"), "Did you mean 'rotor_drag'"),
        (RIGHT.replace("k_xy_1_s", "k_xy"), "Did you mean 'k_xy_1_s'"),
        (RIGHT.replace("1/minute", "m"), 'not a unit of the kind "1/s"'),
        (RIGHT.replace(', source = "made up"', ""), "effects.rotor_drag.k_xy_1_s has no source"),
        ("[effects]\nrotor_drag = 1\n", r"\[effects.rotor_drag\] must be a table"),
    ],
)
def test_a_wrong_effect_in_a_vehicle_file_is_refused(more: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        with_text(more)


def test_effects_of_a_vehicle_are_on() -> None:
    vehicle = plain().with_effects({"mass_offset": {"mass_kg": 0.12}})
    component = airframe(vehicle)
    by_name = {v.name: v.start for v in component.parameters}
    assert (by_name["mass_offset.enabled"], by_name["mass_offset.mass_kg"]) == (1.0, 0.12)
    trim = component.input_values()[0]
    assert trim == pytest.approx(1.1 * airframe(plain()).input_values()[0])
