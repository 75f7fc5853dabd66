"""What workers answer with in the tests; it runs in their processes, so it imports little."""

import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.run import answer, explain_case

NOTHING = {"verdict": "nothing", "effects": [], "seconds": 1.0, "cpu_seconds": 1.0}


def complain(folder: Path) -> dict[str, Any]:
    raise ValueError(folder.name)


def by_name(folder: Path) -> dict[str, Any]:
    """Does what the name of the folder says."""
    match folder.name.split("_")[0]:
        case "crash":
            os._exit(7)
        case "hang":
            time.sleep(60)
        case "raise":
            return answer(folder, complain)
    return {**NOTHING, "pid": os.getpid()}


def watched(folder: Path) -> dict[str, Any]:
    """Explains, and lists every path that Python opened or looked into meanwhile."""
    opened: list[str] = []

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir", "pyarrow.open"):
            opened.append(str(arguments[0]))

    sys.addaudithook(note)
    return {**explain_case(folder), "opened": opened}


def by_setting(asked: tuple[Path, Mapping[str, float]]) -> dict[str, Any]:
    """Finds something where a name is given from a low probability on."""
    low = asked[1].get("inference.selection.sure", 0.8) < 0.5
    return {**NOTHING, "verdict": "unnamed" if low else "nothing"}
