"""What an error about a missing package tells the user to type."""

import re
from importlib.metadata import requires

import pytest
from packaging.requirements import Requirement
from places import ROOT

from twin.errors import install_command

USES = re.compile(r"install_command\(\s*[\"']([\w-]+)[\"']")


SHIPPED = ("twin", "uavtwin", "learning", "fmus", "cosim")
FILES = [f for package in SHIPPED for f in (ROOT / package).rglob("*.py")]


@pytest.mark.parametrize("extra", sorted({e for f in FILES for e in USES.findall(f.read_text())}))
def test_packages_of_a_group_are_named(extra: str) -> None:
    """As the metadata of the package has them, read by another parser."""
    wanted = [Requirement(r) for r in requires("uavtwin") or ()]
    group = [r.name for r in wanted if r.marker and r.marker.evaluate({"extra": extra})]
    assert group
    command = install_command(extra)
    assert command.startswith("pip install ")
    assert re.findall(r"'([\w-]+)>=[\d.]+'", command) == group


def test_a_group_that_is_not_known_is_that_of_the_source_folder() -> None:
    assert install_command("another") == "pip install '.[another]'"
