"""What an FMU says about itself to people."""

import re
import struct
import zipfile
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from fmpy import read_model_description
from lxml import etree, html

from fmus import build, component_model, fuse
from fmus.documentation import documentation, project
from twin.effects import EFFECTS, effects_of
from twin.physics.airframe import airframe
from twin.physics.sensors.imu import imu
from twin.vehicle_file import load_vehicle

COPTER = load_vehicle("copter_default")


def test_the_page_names_every_variable_and_effect() -> None:
    model = component_model(airframe(COPTER, effects=EFFECTS))
    members = documentation(model, 3)
    text = members["documentation/index.html"].decode()
    page = html.fromstring(text)
    named = {code.text for code in page.iter("code")}
    assert named >= {v.name for v in model.variables}
    shown = {h.text_content() for h in page.iter("h3")}
    assert shown == {e.name for e in effects_of("airframe") if f"{e.name}.enabled" in named}
    assert len(shown) > 15
    assert members == documentation(model, 3)
    assert not re.search(
        r"(src|href)=\"(?!licenses/)", members["documentation/index.html"].decode()
    )


@pytest.mark.parametrize("fmi", [2, 3])
def test_it_is_in_the_archive_with_licence_and_author(tmp_path: Path, fmi: int) -> None:
    path = build(component_model(airframe(COPTER)), tmp_path / "a.fmu", fmi)
    with zipfile.ZipFile(path) as archive:
        licence = archive.read("documentation/licenses/license.txt").decode()
        assert "<h1>airframe</h1>" in archive.read("documentation/index.html").decode()
    assert "BSD 3-Clause" in licence and "THIS SOFTWARE IS PROVIDED" in licence
    description = read_model_description(str(path), validate=True)
    assert description.author == project().author
    assert description.license == "BSD-3-Clause"
    assert description.version == project().version


XSD = Path(str(resources.files("fmpy"))) / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"


def test_terminals_are_as_the_standard_says_and_fit_together() -> None:
    """By the schema of FMI 3; what an airframe gives and an IMU takes have the same members."""
    schema = etree.XMLSchema(file=XSD)
    members: dict[str, dict[str, set[str]]] = {}
    models = {
        "airframe": component_model(airframe(COPTER)),
        "imu": component_model(imu(COPTER)),
        "fused": fuse("fused", "Both", {"a": airframe(COPTER), "s": imu(COPTER)}, []),
    }
    for name, model in models.items():
        root = etree.fromstring(documentation(model, 3)["terminalsAndIcons/terminalsAndIcons.xml"])
        schema.assertValid(root)
        ports = {v.name for v in model.variables if v.causality in ("input", "output")}
        assert {m.get("variableName") for m in root.iter("TerminalMemberVariable")} <= ports
        members[name] = {
            "/".join(t.get("name", "") for t in [*terminal.iterancestors("Terminal"), terminal]): {
                m.get("memberName", "") for m in terminal.findall("TerminalMemberVariable")
            }
            for terminal in root.iter("Terminal")
        }
    assert members["airframe"]["motor_commands"] == {f"cmd_{i}" for i in range(1, 5)}
    assert members["imu"]["motion"] < members["airframe"]["motion"]
    assert members["imu"]["sensors"] == {f"{s}_{a}" for s in ("acc", "gyro") for a in "xyz"}
    assert members["fused"]["a/motion"] == members["airframe"]["motion"]
    assert members["fused"]["s/sensors"] == members["imu"]["sensors"]


@pytest.mark.parametrize(("fmi", "place"), [(2, "model.png"), (3, "terminalsAndIcons/icon.png")])
def test_icon(fmi: int, place: str) -> None:
    """A small picture in PNG, its edges equal, as the first chunk says."""
    icon = documentation(component_model(imu(COPTER)), fmi)[place]
    assert icon.startswith(b"\x89PNG\r\n") and len(icon) < 20_000
    width, height = struct.unpack(">II", icon[16:24])
    assert width == height >= 100


def test_texts_of_others_are_text_there() -> None:
    model = replace(component_model(airframe(COPTER)), description="<script>alert(1)</script>")
    page = documentation(model, 2)["documentation/index.html"].decode()
    assert "<script" not in page and "&lt;script&gt;" in page
