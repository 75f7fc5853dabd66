"""What viewers of a live flight get: new messages at once, the last minutes when they join.

Whoever tells never waits for a viewer: each has a queue of its own, and one that does not keep up
loses the oldest messages in it.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

HISTORY_S = 300.0
"""So much of the flight is there for a viewer that comes later."""
_MOST_STORED = 20_000
_MOST_KEYS = 500
QUEUE = 64
"""Messages that wait for one viewer, about three seconds."""
MOST_VIEWERS = 32
SILENT_S = 60.0
"""The page asks for the time every 2 s, in the background once a minute: where there are too many
viewers, one that has asked for nothing for longer gives its place to a new one."""


class Viewer:
    """One who looks on.

    Attributes:
        dropped: Messages that it lost, because it did not keep up.
        heard_s: When it asked for anything last, on the clock of the hub.
        ended: Whether it has to go.
    """

    def __init__(
        self, wake: Callable[[], object], history: list[bytes], now_s: float = 0.0
    ) -> None:
        self._wake, self._history = wake, history
        self._queue: deque[bytes] = deque()
        self.dropped, self.heard_s, self.ended = 0, now_s, False

    def end(self) -> None:
        """Make it go; from any thread."""
        self.ended = True
        with contextlib.suppress(RuntimeError):
            self._wake()

    def put(self, message: bytes) -> None:
        """A message for it; from any thread."""
        if len(self._queue) >= QUEUE:
            with contextlib.suppress(IndexError):  # it was taken in this moment
                self._queue.popleft()
                self.dropped += 1
        self._queue.append(message)
        with contextlib.suppress(RuntimeError):  # its loop has ended
            self._wake()

    def take(self) -> bytes:
        """All that waits, as one JSON array; empty where nothing does."""
        messages, self._history = self._history, []
        with contextlib.suppress(IndexError):
            while len(messages) < _MOST_STORED:
                messages.append(self._queue.popleft())
        return b"[" + b",".join(messages) + b"]" if messages else b""


class Hub:
    """Takes messages from any thread and gives them to all viewers."""

    def __init__(
        self, history_s: float = HISTORY_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._history_s, self._clock = history_s, clock
        self._lock = threading.Lock()
        self._past: deque[tuple[float, bytes]] = deque(maxlen=_MOST_STORED)
        self._newest: dict[str, bytes] = {}
        self._viewers: list[Viewer] = []

    @property
    def viewers(self) -> int:
        """How many look on."""
        return len(self._viewers)

    def send(self, kind: str, content: Mapping[str, Any], key: str = "", keep: bool = True) -> None:
        """A message to all.

        Args:
            kind: What it is.
            content: What it says; what is no finite number becomes null.
            key: Of those of one key only the newest is kept for later viewers.
            keep: Whether it is kept for them.
        """
        message = msgspec.json.encode({"kind": kind, **content})
        with self._lock:
            now = self._clock()
            if keep and key:
                self._newest.pop(key, None)
                self._newest[key] = message
                if len(self._newest) > _MOST_KEYS:
                    del self._newest[next(iter(self._newest))]
            elif keep:
                self._past.append((now, message))
            while self._past and self._past[0][0] < now - self._history_s:
                self._past.popleft()
            for viewer in self._viewers:
                viewer.put(message)

    def join(self, wake: Callable[[], object]) -> Viewer | None:
        """A new viewer; None: there are too many.

        Args:
            wake: Called from any thread when something waits for it.
        """
        with self._lock:
            now = self._clock()
            if len(self._viewers) >= MOST_VIEWERS:
                quietest = min(self._viewers, key=lambda v: v.heard_s)
                if now - quietest.heard_s <= SILENT_S:
                    return None
                self._viewers.remove(quietest)
                quietest.end()
            history = [*self._newest.values(), *(m for _, m in self._past)]
            viewer = Viewer(wake, history, now)
            self._viewers.append(viewer)
            return viewer

    def leave(self, viewer: Viewer) -> None:
        """It looks on no more."""
        with self._lock, contextlib.suppress(ValueError):
            self._viewers.remove(viewer)
