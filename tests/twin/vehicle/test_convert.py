"""Vehicles of other simulators: every number arrives, and flies as it does there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import needs_package
from rig import Rig, q, vec

from twin.errors import ModelError
from twin.frames import from_euler
from twin.physics.airframe import airframe
from twin.vehicle import Vehicle
from twin.vehicle_file import parse_vehicle
from twin.vehicle_file.convert import convert_vehicle

FLIP = np.array([1.0, -1.0, -1.0])
FOOT_M, POUND_N = 0.3048, 4.4482216152605


def converted(path: Path, name: str | None = None) -> Vehicle:
    """The vehicle of a converted file, read back without a doubt of its numbers."""
    vehicle = parse_vehicle(convert_vehicle(path, name), "converted.toml")
    assert all(path.name in s for s in vehicle.sources.values() if not s.startswith("default"))
    return vehicle


# -- Gazebo -----------------------------------------------------------------------------------

LINK = """
<link name="{name}"><pose>{pose}</pose>
  <inertial>{at}<mass>{mass}</mass><inertia>
    <ixx>{moments[0]}</ixx><iyy>{moments[1]}</iyy><izz>{moments[2]}</izz><ixy>{ixy}</ixy>
    <ixz>0</ixz><iyz>0</iyz>
  </inertia></inertial>{more}
</link>"""
JOINT = """
<joint name="{name}_joint" type="{kind}"><parent>base_link</parent><child>{name}</child>
  <axis><xyz>0 0 1</xyz></axis></joint>"""
PLUGIN = """
<plugin filename="gz-sim-multicopter-motor-model-system"
        name="gz::sim::systems::MulticopterMotorModel">
  <jointName>rotor_{i}_joint</jointName><linkName>rotor_{i}</linkName>
  <turningDirection>{way}</turningDirection><motorNumber>{i}</motorNumber>
  <timeConstantUp>0.0125</timeConstantUp><timeConstantDown>0.025</timeConstantDown>
  <maxRotVelocity>1000.0</maxRotVelocity><motorConstant>8.5e-06</motorConstant>
  <momentConstant>0.016</momentConstant><rotorDragCoefficient>8e-05</rotorDragCoefficient>
  <rollingMomentCoefficient>1e-06</rollingMomentCoefficient>
  <rotorVelocitySlowdownSim>10</rotorVelocitySlowdownSim><motorType>velocity</motorType>
</plugin>"""
PLACES = [(0.17, -0.18, 0.06), (-0.17, 0.18, 0.06), (0.17, 0.18, 0.06), (-0.17, -0.18, 0.06)]
WAYS = ["ccw", "ccw", "cw", "cw"]
IMU = '<sensor name="imu" type="imu"><pose>0.01 0.02 0.03 0 0 0</pose></sensor>'


def frame_of_a_quad(base_pose: str = "0 0 0 0 0 0") -> str:
    """Base 2 kg, four rotors of 20 g, a 100 g camera fixed in front."""
    parts = [
        LINK.format(
            name="base_link",
            pose=base_pose,
            at="",
            mass=2.0,
            moments=(0.02, 0.022, 0.04),
            ixy=0.001,
            more=IMU,
        ),
        LINK.format(
            name="camera",
            pose="0.1 0 0 0 0 0",
            at="<pose>0.02 0 0 0 0 0</pose>",
            mass=0.1,
            moments=(1e-5, 2e-5, 3e-5),
            ixy=0.0,
            more="",
        ),
        JOINT.format(name="camera", kind="fixed"),
    ]
    for i, place in enumerate(PLACES):
        pose = " ".join(map(str, (*place, 0, 0, 0)))
        parts.append(
            LINK.format(
                name=f"rotor_{i}",
                pose=pose,
                at="",
                mass=0.02,
                moments=(1e-6, 3e-5, 3.1e-5),
                ixy=0.0,
                more="",
            )
        )
        parts.append(JOINT.format(name=f"rotor_{i}", kind="revolute"))
    return "".join(parts)


def sdf(body: str, name: str = "quad") -> str:
    return f'<?xml version="1.0"?><sdf version="1.9"><model name="{name}">{body}</model></sdf>'


PLUGINS = "".join(PLUGIN.format(i=i, way=way) for i, way in enumerate(WAYS))


def written(folder: Path, text: str, name: str = "model.sdf") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def test_a_multirotor_of_gazebo_is_put_together_about_its_centre_of_mass(tmp_path: Path) -> None:
    v = converted(written(tmp_path, sdf(frame_of_a_quad() + PLUGINS)))
    mass = 2.0 + 0.1 + 4 * 0.02
    assert v.mass_kg == pytest.approx(mass, rel=1e-15)
    centre = np.array([0.1 * 0.12, 0.0, 4 * 0.02 * 0.06]) / mass
    np.testing.assert_allclose(v.rotors.position_m, (np.array(PLACES) - centre) * FLIP, atol=1e-15)
    # Point masses and own moments, about the centre of mass, axes FLU.
    J = (
        np.diag([0.02, 0.022, 0.04])
        + np.diag([1e-5, 2e-5, 3e-5])
        + 4 * np.diag([1e-6, 3e-5, 3.1e-5])
    )
    J[0, 1] = J[1, 0] = 0.001
    for m, place in [(2.0, (0, 0, 0)), (0.1, (0.12, 0, 0)), *[(0.02, p) for p in PLACES]]:
        r = np.array(place) - centre
        J += m * (r @ r * np.eye(3) - np.outer(r, r))
    np.testing.assert_allclose(v.inertia_kg_m2, np.diag(FLIP) @ J @ np.diag(FLIP), atol=1e-15)
    np.testing.assert_allclose(v.imu_position_m, (np.array([0.01, 0.02, 0.03]) - centre) * FLIP)


def test_every_number_of_gazebos_plugin_arrives(tmp_path: Path) -> None:
    v = converted(written(tmp_path, sdf(frame_of_a_quad() + PLUGINS)))
    r = v.rotors
    np.testing.assert_array_equal(r.direction, [-1, -1, 1, 1])
    assert r.thrust_n == (0.0, 0.0, 8.5e-6)
    assert r.torque_n_m == pytest.approx((0.0, 0.0, 0.016 * 8.5e-6))
    assert r.speed_rad_s == (0.0, 1000.0)
    assert (r.lag_up_s, r.lag_down_s) == (0.0125, 0.025)
    assert (r.air.drag_kg_rad, r.air.rolling_kg_m_rad) == (8e-5, 1e-6)
    assert (r.spin_inertia_kg_m2, r.reaction_inertia_kg_m2) == pytest.approx((3.1e-6, 3.1e-6))
    assert v.doubts == ()


def gazebo(v: np.ndarray, omega: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force, and moment about the base link, of the plugins: FLU, by their source's equations."""
    force, moment = np.zeros(3), np.zeros(3)
    for place, way, speed in zip(PLACES, WAYS, w, strict=True):
        r = np.array(place)
        across = (v + np.cross(omega, r)) * [1, 1, 0]
        thrust = 8.5e-6 * speed**2
        push = np.array([0.0, 0.0, thrust]) - speed * 8e-5 * across
        twist = np.array([0.0, 0.0, -(1 if way == "ccw" else -1) * thrust * 0.016])
        force += push
        moment += np.cross(r, push) + twist - speed * 1e-6 * across
    return force, moment


def test_a_multirotor_of_gazebo_feels_what_its_plugins_push(tmp_path: Path) -> None:
    vehicle = converted(written(tmp_path, sdf(frame_of_a_quad() + PLUGINS)))
    rig = Rig(airframe(vehicle, "rotor_speed"), {"ground.enabled": 0.0})
    J, mass = vehicle.inertia_kg_m2, vehicle.mass_kg
    centre = np.array([0.1 * 0.12, 0.0, 4 * 0.02 * 0.06]) / mass
    rng = np.random.default_rng(3)
    for _ in range(10):
        vel, omega, w = rng.uniform(-6, 6, 3), rng.uniform(-3, 3, 3), rng.uniform(200, 900, 4)
        state = vec("vel", vel) | vec("omega", omega)
        y = rig.outputs(
            rig.state(state), rig.inputs({f"rotor_{i + 1}": x for i, x in enumerate(w)})
        )
        base_v = FLIP * vel - np.cross(FLIP * omega, centre)  # of the base link
        force, moment = gazebo(base_v, FLIP * omega, w)
        moment = FLIP * (moment - np.cross(centre, force))
        # Momentum of rotors that turn ten times slower than they push, cw downwards.
        h = np.array([0.0, 0.0, 3.1e-6 * vehicle.rotors.direction @ w])
        alpha = np.linalg.solve(J, moment - np.cross(omega, J @ omega + h))
        felt = [y[f"specific_force_{a}"] for a in "xyz"]
        np.testing.assert_allclose(felt, FLIP * force / mass, rtol=1e-9, atol=1e-9)
        found = [y[f"angular_acceleration_{a}"] for a in "xyz"]
        np.testing.assert_allclose(found, alpha, rtol=1e-9, atol=1e-9)


def test_a_model_that_includes_its_frame_is_the_same_aircraft(tmp_path: Path) -> None:
    """As PX4's x500 does; the pose of the included model moves everything, and changes nothing."""
    whole = converted(written(tmp_path / "whole", sdf(frame_of_a_quad() + PLUGINS)))
    written(tmp_path / "base", sdf("<pose>0 0 .24 0 0 0</pose>" + frame_of_a_quad(), "base"))
    include = '<include merge="true"><uri>model://base</uri></include>'
    merged = converted(written(tmp_path / "quad", sdf(include + PLUGINS)))
    np.testing.assert_allclose(merged.inertia_kg_m2, whole.inertia_kg_m2, atol=1e-15)
    np.testing.assert_allclose(merged.rotors.position_m, whole.rotors.position_m, atol=1e-15)


def test_body_axes_are_those_of_the_link_that_carries_the_rotors(tmp_path: Path) -> None:
    """A base turned by 90 degrees in the model, rotors given in its own frame."""
    body = frame_of_a_quad(base_pose="1 2 3 0 0 1.5707963267948966")
    for name in ("camera", *(f"rotor_{i}" for i in range(4))):
        link = f'<link name="{name}"><pose'
        body = body.replace(f"{link}>", f'{link} relative_to="base_link">')
    turned = converted(written(tmp_path / "turned", sdf(body + PLUGINS)))
    plain = converted(written(tmp_path / "plain", sdf(frame_of_a_quad() + PLUGINS)))
    np.testing.assert_allclose(turned.rotors.position_m, plain.rotors.position_m, atol=1e-12)
    np.testing.assert_allclose(turned.inertia_kg_m2, plain.inertia_kg_m2, atol=1e-12)


def test_what_a_plugin_leaves_out_is_its_default_and_says_so(tmp_path: Path) -> None:
    short = PLUGINS.replace("<momentConstant>0.016</momentConstant>", "")
    path = written(tmp_path, sdf(frame_of_a_quad() + short))
    assert "defaults of the plugin: momentConstant" in convert_vehicle(path)
    v = converted(path)
    assert "default of MulticopterMotorModel" in v.sources["rotors.torque_per_thrust"]
    assert v.rotors.torque_n_m[2] == pytest.approx(0.016 * 8.5e-6)


Change = Callable[[str], str]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.replace("MulticopterMotorModel", "Other"), "no model with plugins"),
        (lambda t: t.replace("8.5e-06", "9e-06", 1), "motorConstant.*one kind"),
        (lambda t: t.replace(">ccw<", ">left<", 1), "turningDirection"),
        (lambda t: t.replace("0.17 -0.18 0.06 0 0 0", "0.17 -0.18 0.06 0.1 0 0"), "tilted"),
        (lambda t: t.replace("<xyz>0 0 1</xyz>", "<xyz>0 1 0</xyz>"), "tilted"),
        (lambda t: t.replace("<mass>2.0</mass>", ""), "no <mass>"),
        (lambda t: t.replace("<mass>2.0</mass>", "<mass>heavy</mass>"), "'heavy'"),
        (lambda t: t.replace("<motorNumber>3<", "<motorNumber>7<"), "motorNumber runs"),
        (lambda t: t.replace('relative_to="base_link"', 'relative_to="nowhere"'), "'nowhere'"),
        (lambda t: t.replace("<sdf", "<urdf").replace("</sdf", "</urdf"), "not a format"),
        (lambda t: t.replace("</sdf>", ""), "not valid XML"),
        (lambda t: t.replace('<model name="quad">', '<model name="q"><model name="r"/>'), "inside"),
        (lambda t: t.replace("</model>", "<include><uri>x</uri></include></model>"), "not in a"),
        (
            lambda t: t.replace(
                "</model>", "<include><uri>model://../../x</uri></include></model>"
            ),
            "next to that of the file",
        ),
    ],
)
def test_an_sdf_that_cannot_be_said_is_refused(tmp_path: Path, change: Change, says: str) -> None:
    text = sdf(frame_of_a_quad() + PLUGINS).replace(
        '<link name="camera"><pose>', '<link name="camera"><pose relative_to="base_link">'
    )
    assert change(text) != text
    with pytest.raises(ModelError, match=says):
        convert_vehicle(written(tmp_path, change(text)))


def test_an_entity_is_not_followed(tmp_path: Path) -> None:
    """Neither a file of this machine nor a billion laughs."""
    written(tmp_path, "2.0", "secret")
    entity = f'<!DOCTYPE sdf [<!ENTITY e SYSTEM "file://{tmp_path}/secret">]>'
    text = sdf(frame_of_a_quad() + PLUGINS).replace("<sdf", f"{entity}<sdf", 1)
    text = text.replace("<mass>2.0</mass>", "<mass>&e;</mass>")
    with pytest.raises(ModelError, match="document type"):
        convert_vehicle(written(tmp_path, text))


def test_words_of_another_file_stay_words(tmp_path: Path) -> None:
    """A model's name cannot end its string or start an entry."""
    name = "quad&quot;&#10;[body]&#10;mass = 1"
    text = sdf(frame_of_a_quad() + PLUGINS, name)
    vehicle = converted(written(tmp_path, text))
    assert vehicle.name == 'quad" [body] mass = 1'
    assert vehicle.mass_kg == pytest.approx(2.18)


# -- drone-models -----------------------------------------------------------------------------


def drone_models_file() -> Path:
    import drone_models

    return Path(drone_models.__file__).parent / "data" / "params.toml"


@needs_package("drone_models")
@pytest.mark.parametrize("name", ["cf2x_L250", "cf2x_P250", "cf2x_T350", "cf21B_500"])
def test_an_aircraft_of_drone_models_flies_as_it_does_there(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accelerations of body and rotors at random states; its one wrong sign is set right."""
    monkeypatch.setenv("SCIPY_ARRAY_API", "1")
    from drone_models.core import load_params
    from drone_models.first_principles import dynamics

    its: dict[str, Any] = load_params("first_principles", name)
    used = ["mass", "L", "prop_inertia", "gravity_vec", "J", "J_inv", "rpm2thrust", "rpm2torque"]
    used += ["mixing_matrix", "drag_matrix", "rotor_dyn_coef"]
    its = {k: np.asarray(its[k], dtype=np.float64) for k in used}
    vehicle = converted(drone_models_file(), name)
    assert vehicle.doubts == ()
    rig = Rig(airframe(vehicle, "command"), {"ground.enabled": 0.0})
    low, high = (_rpm_of(vehicle, command) for command in (0.0, 1.0))
    rng = np.random.default_rng(5)
    for _ in range(20):
        attitude = from_euler(*rng.uniform(-0.8, 0.8, 3))
        vel, omega = rng.uniform(-4, 4, 3), rng.uniform(-6, 6, 3)
        rpm, command = rng.uniform(low, high, 4), rng.uniform(0, 1, 4)
        speed = rpm * 2 * np.pi / 60
        state = q(attitude) | vec("vel", vel) | vec("omega", omega)
        state |= {f"rotor_{i}": x for i, x in enumerate(speed, start=1)}
        rates = rig.rates(rig.state(state), rig.commands(command))
        w, x, y, z = attitude
        _, _, acceleration, turning, spin_up = dynamics(
            np.zeros(3),
            np.array([x, -y, -z, w]),
            FLIP * vel,
            FLIP * omega,
            low + command * (high - low),
            rpm,
            **its,
        )
        wrong = np.zeros(3)
        momentum = its["prop_inertia"] * (its["mixing_matrix"][-1] @ speed)
        wrong[0] = -2 * (FLIP * omega)[1] * momentum / its["J"][0, 0]
        ours = np.array([[rates[f"{s}_{a}"] for a in "xyz"] for s in ("vel", "omega")])
        np.testing.assert_allclose(ours[0], FLIP * acceleration, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours[1], FLIP * (turning - wrong), rtol=1e-9, atol=1e-8)
        rotors = [rates[f"rotor_{i}"] * 60 / (2 * np.pi) for i in range(1, 5)]
        np.testing.assert_allclose(rotors, spin_up, rtol=1e-9)


def _rpm_of(vehicle: Vehicle, command: float) -> float:
    assert vehicle.rotors.speed_rad_s is not None
    return float(np.polynomial.Polynomial(vehicle.rotors.speed_rad_s)(command)) * 60 / (2 * np.pi)


@needs_package("drone_models")
def test_limits_of_thrust_of_drone_models_are_limits_of_the_command() -> None:
    vehicle = converted(drone_models_file(), "cf21B_500")
    assert vehicle.rotors.speed_rad_s is not None
    for command, thrust in ((0.0, 0.02136263065537499), (1.0, 0.2)):
        speed = np.polynomial.Polynomial(vehicle.rotors.speed_rad_s)(command)
        found = np.polynomial.Polynomial(vehicle.rotors.thrust_n)(speed)
        assert found == pytest.approx(thrust, rel=1e-12)


AIRCRAFT = """
[mine]
gravity_vec = [0.0, 0.0, -9.81]
mass = 0.03
L = 0.03
J = [[1.6e-5, 1e-7, 2e-7], [1e-7, 1.7e-5, 3e-7], [2e-7, 3e-7, 2.9e-5]]
rpm2thrust = [0.0, 0.0, 2.4e-10]
rpm2torque = [0.0, 0.0, 1.4e-12]
rotor_dyn_coef = [7.0, 0.0, 0.0, 0.0002]
mixing_matrix = [[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0]]
drag_matrix = [[-0.01, 0.0, 0.0], [0.0, -0.02, 0.0], [0.0, 0.0, -0.03]]
prop_inertia = 3e-8
thrust_min = 0.01
thrust_max = 0.12
"""


def test_inertia_is_turned_to_forward_right_down(tmp_path: Path) -> None:
    v = converted(written(tmp_path, AIRCRAFT, "params.toml"))
    J = [[1.6e-5, -1e-7, -2e-7], [-1e-7, 1.7e-5, 3e-7], [-2e-7, 3e-7, 2.9e-5]]
    np.testing.assert_allclose(v.inertia_kg_m2, J, rtol=1e-15)
    np.testing.assert_array_equal(v.drag_linear_n_s_m, [0.01, 0.02, 0.03])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t + t.replace("[mine]", "[other]"), "say which aircraft; it holds: mine, other"),
        (lambda t: t.replace("mass = 0.03\n", ""), "mine has no mass"),
        (lambda t: t.replace("mass = 0.03", 'mass = "light"'), "mine.mass must be numbers"),
        (lambda t: t.replace("[[-0.01, 0.0,", "[[-0.01, 0.1,"), "off its diagonal"),
        (lambda t: t.replace("thrust_max = 0.12", "thrust_max = -1.0"), "never reaches"),
        (lambda t: t.replace("0.0, -9.81]", "0.0, 9.81]"), "must point down"),
        (lambda t: t.replace("rpm2thrust", "rpm3thrust"), "not a format that is known here"),
        (lambda t: t.replace("[mine]", "[mine"), "not valid TOML"),
    ],
)
def test_a_file_of_drone_models_with_a_mistake_is_refused(
    tmp_path: Path, change: Change, says: str
) -> None:
    with pytest.raises(ModelError, match=says):
        convert_vehicle(written(tmp_path, change(AIRCRAFT), "params.toml"))


def test_an_aircraft_that_is_not_in_the_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="there is no aircraft 'yours'; it holds: mine"):
        convert_vehicle(written(tmp_path, AIRCRAFT, "params.toml"), "yours")


# -- PyFlyt -----------------------------------------------------------------------------------

YAML = """\
motor_params:
  total_thrust: 2.0  # N
  thrust_coef: 3.16e-10
  torque_coef: 7.94e-12
  noise_ratio: 0.02
  tau: 0.01

drag_params:
  drag_coef_xyz: 3.0
  drag_area_xyz: 4.0e-4
  drag_coef_pqr: 1.0e-4

control_params:
  ang_vel:
    kp: [4.0e-2, 4.0e-2, 8.0e-2]
"""
PROPS = [(0.03, -0.028), (-0.03, 0.028), (0.03, 0.028), (-0.03, -0.028)]


def urdf(prop_mass: float = 0.0) -> str:
    """A body of 27 g; motors as frames with an offset centre of mass, or by the joint's origin."""
    links, joints = [], []
    for i, (x, y) in enumerate(PROPS):
        at, origin = (f"{x} {y} 0", "") if i % 2 else ("0 0 0", f'<origin xyz="{x} {y} 0"/>')
        links.append(
            f'<link name="p{i}"><inertial><origin xyz="{at}"/><mass value="{prop_mass}"/>'
            f'<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>'
        )
        ends = f'<parent link="base"/><child link="p{i}"/>'
        joints.append(f'<joint name="j{i}" type="fixed">{origin}{ends}</joint>')
    return (
        '<robot name="r"><link name="base"><inertial><mass value="0.027"/><inertia ixx="1.4e-5" '
        'ixy="1e-7" ixz="0" iyy="1.5e-5" iyz="0" izz="2.17e-5"/></inertial></link>'
        f"{''.join(links + joints)}</robot>"
    )


def pyflyt(folder: Path, yaml: str = YAML, xml: str | None = None) -> Path:
    written(folder, urdf() if xml is None else xml, "quad.urdf")
    return written(folder, yaml, "quad.yaml")


def test_every_number_of_pyflyt_arrives(tmp_path: Path) -> None:
    v = converted(pyflyt(tmp_path))
    assert v.mass_kg == 0.027
    np.testing.assert_allclose(
        v.inertia_kg_m2, [[1.4e-5, -1e-7, 0], [-1e-7, 1.5e-5, 0], [0, 0, 2.17e-5]], rtol=1e-15
    )
    np.testing.assert_allclose(v.rotors.position_m[:, :2], np.array(PROPS) * [1, -1])
    np.testing.assert_array_equal(v.rotors.direction, [-1, -1, 1, 1])
    top_rpm = np.sqrt(2.0 / (4 * 3.16e-10))
    command = 0.7
    assert v.rotors.speed_rad_s is not None
    speed = np.polynomial.Polynomial(v.rotors.speed_rad_s)(command)
    assert speed == pytest.approx(command * top_rpm * 2 * np.pi / 60, rel=1e-12)
    thrust, torque = (
        np.polynomial.Polynomial(c)(speed) for c in (v.rotors.thrust_n, v.rotors.torque_n_m)
    )
    assert thrust == pytest.approx(3.16e-10 * (command * top_rpm) ** 2, rel=1e-9)
    assert torque == pytest.approx(7.94e-12 * (command * top_rpm) ** 2, rel=1e-9)
    assert v.rotors.lag_up_s == 0.01
    np.testing.assert_allclose(v.drag_quadratic_n_s2_m2, 0.5 * 1.225 * 3.0 * 4e-4)
    np.testing.assert_array_equal(v.drag_angular_n_m_s2, 1e-4)
    assert v.doubts == ()


def test_a_quadx_feels_what_pyflyts_equations_say(tmp_path: Path) -> None:
    """Props of 2 g each: one rigid body, drag at the base, rates damped where they are positive."""
    vehicle = converted(pyflyt(tmp_path, xml=urdf(0.002)))
    rig = Rig(airframe(vehicle, "rotor_speed"), {"ground.enabled": 0.0})
    mass, hubs = 0.035, np.array([[x, y, 0.0] for x, y in PROPS])
    J = np.array([[1.4e-5, 1e-7, 0], [1e-7, 1.5e-5, 0], [0, 0, 2.17e-5]])
    for r in hubs:
        J = J + 0.002 * (r @ r * np.eye(3) - np.outer(r, r))
    rng = np.random.default_rng(2)
    for _ in range(10):
        vel, rpm = rng.uniform(-5, 5, 3), rng.uniform(5e3, 3e4, 4)
        omega = FLIP * rng.uniform(0.5, 4, 3)
        inputs = {f"rotor_{i + 1}": x * 2 * np.pi / 60 for i, x in enumerate(rpm)}
        y = rig.outputs(rig.state(vec("vel", vel) | vec("omega", omega)), rig.inputs(inputs))
        v, p = FLIP * vel, FLIP * omega
        force = np.array([0, 0, 3.16e-10 * (rpm**2).sum()])
        force = force - 0.5 * 1.225 * 3.0 * 4e-4 * np.sign(v) * v**2
        turn = np.array([-1.0, -1.0, 1.0, 1.0]) * 7.94e-12
        moment = np.array([0, 0, turn @ rpm**2]) - 1e-4 * p**2
        for r, n in zip(hubs, rpm, strict=True):
            moment = moment + np.cross(r, [0, 0, 3.16e-10 * n**2])
        alpha = np.linalg.solve(J, moment - np.cross(p, J @ p))
        felt = [y[f"specific_force_{a}"] for a in "xyz"]
        np.testing.assert_allclose(felt, FLIP * force / mass, rtol=1e-9, atol=1e-9)
        found = [y[f"angular_acceleration_{a}"] for a in "xyz"]
        np.testing.assert_allclose(found, FLIP * alpha, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("yaml", "xml", "says"),
    [
        (YAML.replace("  tau: 0.01\n", ""), None, "motor_params has no tau"),
        (YAML.replace("tau: 0.01", "tau: fast"), None, "motor_params.tau is 'fast'"),
        (YAML.replace("tau: 0.01", "tau: [1, 2]"), None, "line 6.*is not 'key: number'"),
        (YAML.replace("torque_coef: ", "torque_coef: -"), None, "torque_coef.*negative"),
        (YAML.replace("drag_params", "drag"), None, "not a format that is known"),
        (YAML, urdf().replace('type="fixed"', 'type="continuous"'), "joints that move"),
        (YAML, urdf().replace('<mass value="0.027"/>', ""), "value.*1 number"),
        (YAML, urdf().replace('child link="p3"', 'child link="p9"'), "base link"),
        (YAML, "<robot/>", "base link"),
        (YAML, "<robot", "not valid XML"),
    ],
)
def test_a_vehicle_of_pyflyt_with_a_mistake_is_refused(
    tmp_path: Path, yaml: str, xml: str | None, says: str
) -> None:
    with pytest.raises(ModelError, match=says):
        convert_vehicle(pyflyt(tmp_path, yaml, xml))


def test_a_yaml_without_its_urdf_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"quad\.urdf, which must lie next to it"):
        convert_vehicle(written(tmp_path, YAML, "quad.yaml"))


# -- JSBSim -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def f450() -> tuple[Any, Vehicle]:
    """JSBSim with its F450, and the vehicle of the converted file."""
    import jsbsim

    root = Path(jsbsim.__file__).parent
    fdm = jsbsim.FGFDMExec(str(root))
    fdm.set_debug_level(0)
    fdm.load_model("F450")
    fdm.set_dt(1e-3)
    return fdm, converted(root / "aircraft" / "F450" / "F450.xml")


@pytest.mark.slow
@needs_package("jsbsim")
def test_the_f450_of_jsbsim_feels_what_it_does_there(f450: tuple[Any, Vehicle]) -> None:
    """Drag and thrust in a tumbling climb and fall, at the rotor speeds of JSBSim itself."""
    fdm, vehicle = f450
    rig = Rig(airframe(vehicle, "rotor_speed"), {"ground.enabled": 0.0})
    rng = np.random.default_rng(1)
    ratios = []
    for _ in range(6):
        for names, unit, size in (("uvw", "-fps", 12.0), ("pqr", "-rad_sec", 2.0)):
            for name, value in zip(names, rng.uniform(-size, size, 3), strict=True):
                fdm[f"ic/{name}{unit}"] = value
        fdm["ic/w-fps"] = rng.uniform(-25.0, 5.0)  # most of them climb
        fdm["ic/h-agl-ft"] = 300.0
        for name, value in zip(
            ("phi", "theta", "psi-true"), rng.uniform(-0.4, 0.4, 3), strict=True
        ):
            fdm[f"ic/{name}-rad"] = value
        fdm.run_ic()
        speeds = np.zeros(4)
        for _ in range(150):
            # A propeller pushes at the speed before its own step.
            speeds = np.array(
                [fdm[f"propulsion/engine[{i}]/propeller-rpm"] * np.pi / 30 for i in range(4)]
            )
            for i in range(4):
                fdm[f"fcs/throttle-cmd-norm[{i}]"] = 0.5 + 0.1 * i
            fdm.run()
        y = rig.outputs(rig.state(_state_of(fdm)), _inputs_of(rig, fdm, speeds))
        thrust = [fdm[f"propulsion/engine[{i}]/thrust-lbs"] * POUND_N for i in range(4)]
        ours = np.array([y[f"thrust_{i}"] for i in range(1, 5)])
        drag = [fdm[f"forces/fb{a}-aero-lbs"] * POUND_N for a in "xyz"]
        force = 1.4 * np.array([y[f"specific_force_{a}"] for a in "xyz"])
        force[2] += ours.sum()
        np.testing.assert_allclose(force, drag, rtol=1e-4, atol=1e-6)
        # Hubs climb at other speeds than the centre of mass, where JSBSim has them all.
        np.testing.assert_allclose(ours.sum(), np.sum(thrust), rtol=2e-3)
        at_rest = vehicle.rotors.thrust_n[2] * speeds**2 * fdm["atmosphere/rho-slugs_ft3"]
        ratios.append(np.sum(thrust) / np.sum(at_rest * 515.378818 / 1.225))
    assert min(ratios) < 0.8  # the table is felt


def _state_of(fdm: Any) -> dict[str, float]:
    angles = (fdm[f"attitude/{n}-rad"] for n in ("phi", "theta", "psi"))
    velocity = [fdm[f"velocities/v-{d}-fps"] * FOOT_M for d in ("north", "east", "down")]
    rates = [fdm[f"velocities/{b}-rad_sec"] for b in "pqr"]
    return q(from_euler(*angles)) | vec("vel", velocity) | vec("omega", rates)


def _inputs_of(rig: Rig, fdm: Any, speeds: np.ndarray) -> np.ndarray:
    rotors = {f"rotor_{i}": w for i, w in enumerate(speeds, start=1)}
    return rig.inputs(rotors, density=fdm["atmosphere/rho-slugs_ft3"] * 515.378818)


@needs_package("jsbsim")
def test_numbers_of_the_f450_arrive(f450: tuple[Any, Vehicle]) -> None:
    _, v = f450
    assert v.mass_kg == 1.4
    np.testing.assert_allclose(np.diag(v.inertia_kg_m2), [0.019, 0.019, 0.0252])
    assert v.leg_height_m == pytest.approx(0.1524)
    np.testing.assert_allclose(v.drag_parasitic_n_s2_m2, 0.5 * 1.225 * 0.016129)
    assert v.drive == "rotor_speed"
    assert v.rotors.advance is not None
    assert v.rotors.advance.diameter_m == pytest.approx(9.4 * 0.0254)
    assert v.rotors.advance.thrust[3] == pytest.approx((0.073, 0.123 / 0.1288))
    assert v.rotors.advance.torque[-1] == pytest.approx((0.7291, 0.0061 / 0.0666))
    assert v.rotors.spin_inertia_kg_m2 == 6.05e-5


@needs_package("jsbsim")
@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        ("Mass.xml", '<ixy unit="KG*M2">0.0', '<ixy unit="KG*M2">0.1', "products of inertia"),
        ("Mass.xml", 'unit="KG"', 'unit="STONE"', "unit 'STONE'"),
        ("Propulsion.xml", "<pitch>90", "<pitch>80", "tilted"),
        ("Propulsion.xml", "<p_factor>0.0", "<p_factor>0.5", "p_factor"),
        (
            "Propulsion.xml",
            'thruster file="DJI_9450"',
            'thruster file="../x"',
            "none of the folders",
        ),
        ("Aero.xml", "<value> 1.0 </value>", "<random/>", "<random> in aerodynamics is not read"),
        (
            "Aero.xml",
            "dCL__alpha_rad</description>\n\n        <value> 0",
            "dCL__alpha_rad</description>\n\n        <value> 2",
            "axis LIFT",
        ),
    ],
)
def test_an_aircraft_of_jsbsim_that_cannot_be_said_is_refused(
    tmp_path: Path, file: str, old: str, new: str, says: str
) -> None:
    import jsbsim

    root = Path(jsbsim.__file__).parent
    folder = tmp_path / "aircraft" / "F450"
    for source in (root / "aircraft" / "F450").glob("*.xml"):
        text = source.read_text("utf-8").replace("\r\n", "\n")
        if source.name == file:
            assert old in text
            text = text.replace(old, new)
        written(folder, text, source.name)
    for name in ("DJI_9450.xml", "DJI_E305.xml"):
        written(tmp_path / "engine", (root / "engine" / name).read_text("utf-8"), name)
    with pytest.raises(ModelError, match=says):
        convert_vehicle(folder / "F450.xml")


# -- what is none of these --------------------------------------------------------------------


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such file"):
        convert_vehicle(tmp_path / "nothing.sdf")


@pytest.mark.parametrize("name", ["notes.txt", "vehicle.toml", "x.yaml", "x.xml", "x.sdf"])
def test_another_format_is_refused_with_those_that_are_known(tmp_path: Path, name: str) -> None:
    text = "<a/>" if name.endswith(("xml", "sdf")) else "[body]\n"
    with pytest.raises(ModelError, match="not a format that is known here: SDF of Gazebo"):
        convert_vehicle(written(tmp_path, text, name))
