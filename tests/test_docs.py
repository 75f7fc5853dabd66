"""Documentation says what the code says; every example and every TOML of it works."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from twin.vehicle.file import parse_vehicle

ROOT = Path(__file__).parents[1]


def test_tables_are_generated_from_the_code() -> None:
    result = subprocess.run(
        [sys.executable, ROOT / "docs" / "_generate" / "tables.py", "--check"],
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + "run: python docs/_generate/tables.py"


def _blocks() -> list[str]:
    return re.findall(
        r"```toml\n(.*?)```", (ROOT / "docs" / "guide" / "vehicle.md").read_text(), re.DOTALL
    )


def test_the_vehicle_of_the_documentation_loads() -> None:
    example, commanded, *_ = _blocks()
    assert parse_vehicle(example, "example.toml").drive == "rotor_speed"
    assert parse_vehicle(example + commanded, "example.toml").drive == "command"


def test_every_polynomial_of_the_documentation_loads() -> None:
    example, _, variants, raw = _blocks()
    light = example.replace("value = 1.2,", "value = 0.03,")  # each map carries 30 g
    body = light.split("thrust_from_speed")[0]
    torque = 'torque_per_thrust = { value = 0.01, unit = "m", source = "x" }\n'
    maps = [line for line in variants.splitlines() if line.startswith("thrust")] + [raw]
    assert len(maps) == 5
    for text in maps:
        assert parse_vehicle(body + torque + text, "variant.toml").rotors.thrust_n


SHORT = {"fly_tour_in_wind.py": ["3"], "ab_effect.py": ["8"], "swap_controller.py": ["3"]}
"""Arguments that make an example fly less than its reader wants."""
SAYS = {
    "fly_tour_in_wind.py": r"still air .* rms(.|\n)*5 m/s, gusts .* rms",
    "ab_effect.py": r"False: nose 0\.\d+ degrees up(.|\n)*True : nose [89]\.\d+ degrees up",
    "swap_controller.py": r"lqr  0\.\d+ m rms(.|\n)*px4  0\.\d+ m rms",
    "replay_beside_twin.py": r"the twin is 0\.\d+ m off",
    "foreign_fmu.py": r"gust of 0 m/s: 0\.0\d+ m(.|\n)*gust of 8 m/s: 0\.[1-9]\d+ m",
}


@pytest.mark.parametrize("script", sorted(p.name for p in (ROOT / "examples").glob("*.py")))
def test_examples_run(script: str) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", ROOT / "examples" / script, *SHORT.get(script, [])],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    assert re.search(SAYS.get(script, r"\w"), result.stdout), result.stdout
    assert len((ROOT / "examples" / script).read_text().splitlines()) < 60


@pytest.mark.slow
def test_the_fmu_document_works(tmp_path: Path) -> None:
    """Its blocks in order, as a reader would: shell commands, the Python script, the C program."""
    text = (ROOT / "docs" / "guide" / "fmus.md").read_text()
    script = ["set -eu"]
    for language, block in re.findall(r"```(sh|python|c)\n(.*?)```", text, re.DOTALL):
        if language == "sh":
            script.append(block)
        else:
            name = "main.c" if language == "c" else "main.py"
            script.append(f"cat > {name} <<'END OF FILE'\n{block}END OF FILE")
        if language == "python":
            script.append("python main.py")
    bin_folder = Path(sys.executable).parent
    result = subprocess.run(
        ["bash", "-c", "\n".join(script)],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    *_, drift, height = result.stdout.splitlines()
    assert 0.05 < float(drift.split()[0]) < 0.5  # the wind is felt, and held against
    assert drift.endswith("m from the setpoint at worst")
    assert re.fullmatch(r"1\.[0-9]{3} m above the ground", height), height
    assert (tmp_path / "twin" / "flight.csv").read_text().startswith('"time"')


@pytest.mark.parametrize("log", ["log10", "log15", "log16"])
def test_motor_delay_example_on_its_data(data_dir: Path, tmp_path: Path, log: str) -> None:
    source = data_dir / "crazyflie_motor_delay" / f"{log}.parquet"
    script = ROOT / "examples" / "crazyflie_motor_delay_to_flight_table.py"
    subprocess.run(
        [sys.executable, script, source, tmp_path / "flight.parquet"],
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "flight.parquet").exists()


def test_readme_commands_exist() -> None:
    """Every `uavtwin VERB` that the README names is a verb."""
    from uavtwin.cli.main import app

    verbs = {c.name or c.callback.__name__ for c in app.registered_commands if c.callback}
    named = set(re.findall(r"uavtwin ([a-z]+)", (ROOT / "README.md").read_text()))
    assert named <= verbs | {"is"}, named - verbs
