"""A slave whose calls other processes can read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from numpy.typing import NDArray

from .slave import Array, Slave
from .trace import FOLLOWING, MORE, ONE, QUARTER, TINY, SharedTrace, TracedCall


class TracedSlave(Slave):
    """A slave that writes its calls into a trace and checks after each how this process calculates.

    The calls of the inner loop are written here, at half the cost of `TracedCall`.
    """

    def __init__(self, name: str, path: Path, trace: SharedTrace) -> None:
        """Load and instantiate."""
        self._slot = trace.call
        super().__init__(name, path, trace)

    def bind(
        self, inputs: Sequence[str], outputs: Sequence[str], sent: Array, received: Array
    ) -> None:
        """See `Slave.bind`."""
        super().bind(inputs, outputs, sent, received)
        self._moves_in, self._moves_out = _bare(self._setters), _bare(self._getters)
        doing = cast(TracedCall, self._step.call)
        self._doing = doing.number, -doing.number, doing.bare

    def write_inputs(self) -> None:
        """See `Slave.write_inputs`.

        Raises:
            FmuError: The FMU failed, or changed how this process calculates.
        """
        slot, moves = self._slot, self._moves_in
        for number, returned, set_, buffer, positions in moves:
            if positions is not None:
                buffer[:] = self.inputs[positions]
            slot.value = number
            if status := set_():
                slot.value = returned
                self.judge(status, "set inputs")
        if moves:
            slot.value = returned  # from the last of them
            if ONE + QUARTER + MORE != FOLLOWING or not TINY + TINY:
                raise cast(TracedCall, self._setters[-1][0]).spoilt()

    def read_outputs(self) -> None:
        """See `Slave.read_outputs`.

        Raises:
            FmuError: The FMU failed, or changed how this process calculates.
        """
        slot, moves = self._slot, self._moves_out
        for number, returned, get, buffer, positions in moves:
            slot.value = number
            if status := get():
                slot.value = returned
                self.judge(status, "get outputs")
            if positions is not None:
                self.outputs[positions] = buffer
        if moves:
            slot.value = returned  # from the last of them
            if ONE + QUARTER + MORE != FOLLOWING or not TINY + TINY:
                raise cast(TracedCall, self._getters[-1][0]).spoilt()

    def step(self, time_s: float, step_s: float) -> None:
        """See `Slave.step`.

        Raises:
            FmuError: The FMU failed, or changed how this process calculates.
        """
        step, slot = self._step, self._slot
        number, returned, call = self._doing
        step.time_s.value = time_s
        step.step_s.value = step_s
        slot.value = number
        status = call()
        slot.value = returned
        if ONE + QUARTER + MORE != FOLLOWING or not TINY + TINY:
            raise cast(TracedCall, step.call).spoilt()
        if status or step.flags.value:
            self._judge_step(status)


def _bare(moves: Sequence[Any]) -> list[tuple[int, int, Any, NDArray[Any], NDArray[Any] | None]]:
    """What to write before and after, and the bare call, of what moves values."""
    return [
        (call.number, -call.number, call.bare, buffer, positions)
        for call, buffer, positions in moves
    ]
