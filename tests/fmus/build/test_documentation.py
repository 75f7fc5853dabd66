"""What an FMU says about itself to people."""

import re
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from fmpy import read_model_description
from lxml import html

from fmus import build, component_model
from fmus.documentation import documentation, project
from twin.effects import EFFECTS, effects_of
from twin.physics.airframe import airframe
from twin.vehicle.file import load_vehicle

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


def test_texts_of_others_are_text_there() -> None:
    model = replace(component_model(airframe(COPTER)), description="<script>alert(1)</script>")
    page = documentation(model, 2)["documentation/index.html"].decode()
    assert "<script" not in page and "&lt;script&gt;" in page
