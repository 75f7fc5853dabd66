"""Who made an FMU, under which licence: from the metadata of the installed package."""

from dataclasses import dataclass
from functools import cache
from importlib import metadata

_NAME = "uavtwin"


@dataclass(frozen=True, slots=True)
class Project:
    """What stands in every FMU.

    Attributes:
        name: Of the tool.
        version: Of the package.
        author: Of the code.
        licence: Its short name (SPDX).
        copyright: The line of the licence.
        text: The whole licence. That of the FMI headers among the sources stands in these.
    """

    name: str
    version: str
    author: str
    licence: str
    copyright: str
    text: str


@cache
def project() -> Project:
    """Of this installation."""
    own = metadata.distribution(_NAME)
    text = own.read_text("licenses/LICENSE") or ""
    line = next((line for line in text.splitlines() if line.startswith("Copyright")), "")
    header = own.metadata
    return Project(
        _NAME, own.version, header["Author"] or "", header["License-Expression"] or "", line, text
    )
