"""Connections of the server, with time limits.

Without limits, idle connections could block other viewers.
"""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

_MOST_IDLE = 64
"""Largest number of open connections without a request; the oldest of more is closed."""
_REQUEST_S, _ANSWER_S = 5.0, 60.0
"""Time limit for the head of a request, and for a pause in its content or its answer, s. A large
log over a slow network has no total limit."""
_WATCH_S = 1.0
"""Interval of checks of a connection, s."""


class LimitedConnection(H11Protocol):
    """A connection until it becomes a WebSocket, closed when its viewer is too slow."""

    _received = _resumed = _answered = 0
    _state: tuple[int, ...] | None = None
    _since = 0.0
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start of the connection, as in asyncio."""
        super().connection_made(transport)
        self._watch()
        idle = [
            c
            for c in self.connections
            if isinstance(c, LimitedConnection) and c._is_idle() and not c.transport.is_closing()
        ]
        if len(idle) > _MOST_IDLE:
            min(idle, key=lambda c: c._since).transport.abort()

    def data_received(self, data: bytes) -> None:
        """Received data, as in asyncio."""
        self._received += len(data)
        super().data_received(data)

    def resume_writing(self) -> None:
        """End of a full buffer, as in asyncio."""
        self._resumed += 1
        super().resume_writing()

    def on_response_complete(self) -> None:
        """End of an answer, as in uvicorn."""
        self._answered += 1
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """End of the connection, as in asyncio."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def _watch(self) -> None:
        """Close the connection if its viewer was inactive for too long, else check again later."""
        if self not in self.connections:
            return  # it is a WebSocket now
        state, now = self._progress(), self.loop.time()
        if state is None or state != self._state:
            self._state, self._since = state, now
        if now - self._since > (_REQUEST_S if self._is_idle() else _ANSWER_S):
            self.transport.abort()
        else:
            self._timer = self.loop.call_later(_WATCH_S, self._watch)

    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _is_idle(self) -> bool:
        """Whether a request is expected: all answers are complete."""
        return not self._is_answering() and not self.transport.get_write_buffer_size()

    def _progress(self) -> tuple[int, ...] | None:
        """State that changes with the viewer's activity; None: the server is active."""
        if self._is_idle():
            return (self._answered,)  # a few bytes of a head are no progress
        unsent = self.transport.get_write_buffer_size()
        content_due = self._is_answering() and self.cycle.more_body and not self.flow.read_paused
        if not unsent and not content_due:
            return None
        return self._received, self._resumed, self._answered, unsent
