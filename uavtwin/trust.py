"""FMUs that a user vouches for, by the hash of their file."""

import re
from dataclasses import replace
from pathlib import Path

from cosim.system import System
from twin.errors import TwinError

from .output import sha256

_LINE = re.compile(r"\\?([0-9a-f]{64}) [ *].+")


def read_hashes(path: Path) -> frozenset[str]:
    """Hashes of a file that `sha256sum` wrote.

    Raises:
        TwinError: Not readable, a line is of another form, or there is none.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TwinError(f"{path}: cannot be read: {error}.") from error
    found = [_LINE.fullmatch(line) for line in lines]
    for number, line in enumerate(found, start=1):
        if line is None:
            raise TwinError(f"{path}: line {number} is not of sha256sum; write sha256sum *.fmu.")
    if not found:
        raise TwinError(f"{path}: holds no hash; write it with sha256sum.")
    return frozenset(line[1] for line in found if line)


def trusted(system: System, ssp: Path, hashes: Path) -> System:
    """The system of an `.ssp` as one of ours: a file of hashes names the `.ssp` or all its FMUs.

    Raises:
        TwinError: The file of hashes is wrong, or an FMU is not in it.
    """
    known = read_hashes(hashes)
    if sha256(ssp) not in known:
        for name, path in system.fmus.items():
            if (found := sha256(path)) not in known:
                raise TwinError(
                    f"{name} ({path.name}): its sha256 {found} is not in {hashes.name}. Add it if "
                    f"you trust the FMU; without --trust all run in a process of their own."
                )
    return replace(system, foreign=False)
