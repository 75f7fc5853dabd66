"""`uavtwin vehicle convert` and `ut.convert_vehicle`: an aircraft of Gazebo becomes one of ours."""

from pathlib import Path

import numpy as np
import pytest
from cli_rig import run as uavtwin

import uavtwin as ut

MASS_KG, ROTOR_KG, ARM_M, WAYS = 1.2, 0.01, 0.15, ("ccw", "ccw", "cw", "cw")
PLACES_FLU = ((1, -1), (-1, 1), (1, 1), (-1, -1))


def link(name: str, mass_kg: float, moment: float, place: str = "0 0 0") -> str:
    return f"""
<link name="{name}"><pose>{place} 0 0 0</pose><inertial><mass>{mass_kg}</mass><inertia>
  <ixx>{moment}</ixx><iyy>{moment}</iyy><izz>{moment}</izz></inertia></inertial></link>"""


def rotor(i: int) -> str:
    x, y = (ARM_M * side for side in PLACES_FLU[i])
    return f"""{link(f"rotor_{i}", ROTOR_KG, 1e-6, f"{x} {y} 0.05")}
<joint name="joint_{i}" type="revolute"><parent>base_link</parent><child>rotor_{i}</child>
  <axis><xyz>0 0 1</xyz></axis></joint>
<plugin filename="gz-sim-multicopter-motor-model-system"
        name="gz::sim::systems::MulticopterMotorModel">
  <jointName>joint_{i}</jointName><linkName>rotor_{i}</linkName><motorNumber>{i}</motorNumber>
  <turningDirection>{WAYS[i]}</turningDirection><motorConstant>8e-06</motorConstant>
  <momentConstant>0.02</momentConstant><rotorDragCoefficient>1e-04</rotorDragCoefficient>
  <maxRotVelocity>900</maxRotVelocity><motorType>velocity</motorType></plugin>"""


@pytest.fixture
def sdf(tmp_path: Path) -> Path:
    """A quadrotor of 1.24 kg."""
    parts = link("base_link", MASS_KG, 0.01) + "".join(map(rotor, range(4)))
    path = tmp_path / "model.sdf"
    path.write_text(f'<sdf version="1.9"><model name="mine">{parts}</model></sdf>', "utf-8")
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `uavtwin vehicle convert`."""
    return uavtwin(capsys, "vehicle", "convert", *arguments)


def test_the_aircraft_of_a_file_arrives(
    capsys: pytest.CaptureFixture[str], sdf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "made" / "mine.toml"
    code, said, _ = run(capsys, sdf, "--out", out)
    assert code == 0
    assert "1.24 kg, 4 rotors" in said
    assert "Left out: collision shapes" in said
    vehicle = ut.load_vehicle(out)
    assert vehicle.mass_kg == pytest.approx(MASS_KG + 4 * ROTOR_KG)
    np.testing.assert_allclose(
        vehicle.rotors.position_m[:, :2], [(ARM_M * x, -ARM_M * y) for x, y in PLACES_FLU]
    )
    hover = np.sqrt(vehicle.mass_kg * 9.80665 / 4 / 8e-6) / 900  # command: share of 900 rad/s
    found = ut.check(out)
    assert found.facts["hovers at"] == "command " + ", ".join([f"{hover:.4g}"] * 4)
    assert not found.problems


def test_from_python_without_a_file(sdf: Path) -> None:
    vehicle = ut.convert_vehicle(sdf)
    assert vehicle.name == "mine"
    assert vehicle.text.startswith("# Converted from model.sdf of Gazebo")
    assert vehicle.toml() == vehicle.text


def test_a_file_that_is_there_is_kept(
    capsys: pytest.CaptureFixture[str], sdf: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mine.toml"
    out.write_text("precious")
    code, _, said = run(capsys, sdf, "--out", out)
    assert (code, out.read_text()) == (2, "precious")
    assert "mine.toml: exists. Choose another --out or add --force." in said
    assert run(capsys, sdf, "--out", out, "--force")[0] == 0
    assert ut.load_vehicle(out).name == "mine"
    code, _, said = run(capsys, sdf, "--out", tmp_path, "--force")
    assert (code, "is a folder; name a file" in said) == (2, True)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("nothing.sdf", None, "nothing.sdf: no such file"),
        ("notes.txt", "", "not a format that is known here: SDF of Gazebo"),
        ("a.sdf", "<sdf><model name='x'/></sdf>", "a.sdf"),
        ("mine.toml", 'name = "x"', "not a format that is known here"),
    ],
)
def test_what_cannot_be_converted_is_told(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str, text: str | None, said: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text, "utf-8")
    out = tmp_path / "out.toml"
    code, _, error = run(capsys, tmp_path / name, "--out", out)
    assert code == 2
    assert said in error
    assert not out.exists()
