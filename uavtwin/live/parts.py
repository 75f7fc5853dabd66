"""Parts of a live session that may fail while the recording goes on."""

import contextlib
import traceback
from collections import Counter
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from threading import Lock
from typing import ParamSpec, TypeVar

from twin.errors import TwinError
from twin.logs.flight import Finding

ERRORS = "errors.txt"
"""In the folder of a recording: tracebacks."""
_MOST = 50
"""Different errors of which the text is kept."""
_P = ParamSpec("_P")
_T = TypeVar("_T")


class Part(Enum):
    """What may fail by itself."""

    RECEIVER = "the receiver"
    DECODER = "the decoder"
    ROWS = "the flight table"
    RAW = "raw.tlog"
    TABLES = "recorded tables"
    SECTION = "the flight section"
    TWIN = "the twin"
    SHOWN = "the twin that is shown"
    PUBLISHER = "the publisher"
    PAGE = "the page"
    ALARMS = "alarms"
    COMPENSATOR = "the compensator"


_STATEFUL = {Part.RAW, Part.TABLES, Part.TWIN, Part.SHOWN, Part.ALARMS, Part.COMPENSATOR}
"""Their state is lost with an error: they are called again in the next flight section."""


class Parts:
    """Calls parts of a session so that an error of one ends no other.

    An error is reported once, its repetitions are counted. From any thread.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """No part has failed.

        Args:
            folder: Of the recording, which gets the tracebacks; None: nothing is recorded.
        """
        self._folder, self._lock = folder, Lock()
        self._counts: Counter[tuple[str, str]] = Counter()
        self._resting: set[Part] = set()

    def run(
        self, part: Part, work: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs
    ) -> _T | None:
        """Call a part; None where it fails, or has failed in this flight section."""
        if part in self._resting:
            return None
        try:
            return work(*args, **kwargs)
        except Exception as error:
            self._note(part, error)
            if part in _STATEFUL:
                self._resting.add(part)
            return None

    def wake(self) -> None:
        """A new flight section begins: each part is called again."""
        self._resting.clear()

    def _note(self, part: Part, error: Exception) -> None:
        text = str(error) if isinstance(error, TwinError) else f"{type(error).__name__}: {error}"
        key = part.value, text
        with self._lock:
            if key not in self._counts and len(self._counts) >= _MOST:
                key = part.value, "further errors"
            self._counts[key] += 1
            new = self._counts[key] == 1
        if new and self._folder is not None:
            trace = "".join(traceback.format_exception(error))
            # The disk may be what has failed: the error is reported all the same.
            with (
                contextlib.suppress(OSError),
                (self._folder / ERRORS).open("a", encoding="utf-8", errors="replace") as file,
            ):
                file.write(f"{part.value}\n{trace}\n")

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Every error so far, once each."""
        with self._lock:
            counts = dict(self._counts)
        return tuple(Finding("error", part, f"failed: {e}", n) for (part, e), n in counts.items())
