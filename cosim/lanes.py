"""Several runs of one FMU at once, one in each SIMD lane; every number equals that of the master to
the last bit.

Only for FMUs of this program: their code runs in this process.
"""

import ctypes
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fmus.lanes import LANES, lanes_library
from twin.errors import FmuError

from .interface import read_interface
from .recording import Recording
from .system import System

_MESSAGE_BYTES = 400
_Numbers = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
_References = np.ctypeslib.ndpointer(np.uint32, flags="C_CONTIGUOUS")


class LaneMaster:
    """Master for a system of one FMU without connections, flown in lanes.

    Attributes:
        lanes: Number of runs at once.
        record_names: "slave.variable" of each recorded column.
    """

    def __init__(
        self, system: System, record: Sequence[str] | None = None, lanes: int = LANES
    ) -> None:
        """Compile and load the library.

        Args:
            system: System to run.
            record: Recorded outputs, as for `Master`.
            lanes: Number of runs at once.

        Raises:
            FmuError: The system has several FMUs or connections, or there is no compiler for it.
        """
        if len(system.fmus) != 1 or system.connections or system.foreign:
            raise FmuError("lanes: for one FMU of ours, without connections.")
        ((name, fmu),) = system.fmus.items()
        self._system, self._interface, self.lanes = system, read_interface(fmu), lanes
        outputs = [f"{name}.{v}" for v in self._interface.names("output")]
        self.record_names = tuple(outputs if record is None else record)
        self._read = self._references(self.record_names)
        with tempfile.TemporaryDirectory(prefix="uavtwin-") as folder:
            file = Path(folder, "lanes.so")
            file.write_bytes(lanes_library(fmu, lanes))
            self._fly = ctypes.CDLL(str(file)).lanes_fly
        some, whole = ctypes.c_uint, ctypes.c_long
        self._fly.argtypes = [
            *(ctypes.c_double, some, _References, _Numbers),
            *(ctypes.c_double, whole, whole, some, _References, _Numbers),
            *(ctypes.c_char_p, ctypes.c_size_t),
        ]

    def run(
        self,
        starts: Sequence[Mapping[str, float]],
        start_time_s: float,
        stop_time_s: float,
        step_s: float,
        every: int = 1,
    ) -> list[Recording]:
        """Recordings equal to those of `Master.initialize` and `Master.run` with the same
        arguments.

        Args:
            starts: Start values of each run, added to those of the system; at most `lanes` runs.
            start_time_s: Time of the first communication point.
            stop_time_s: Time of the last one.
            step_s: Communication step.
            every: Number of steps between recorded rows.

        Raises:
            FmuError: At least one run failed; the master reports the outcome of each.
        """
        given = [{**self._system.starts, **own} for own in starts]
        given += [given[-1]] * (self.lanes - len(given))
        names = tuple(dict.fromkeys(name for own in given for name in own))
        values = np.array([[own.get(name, np.nan) for own in given] for name in names])
        if np.isnan([value for own in given for value in own.values()]).any():
            raise FmuError("lanes: a start value is no number.")
        steps = round((stop_time_s - start_time_s) / step_s)
        rows = np.empty((steps // every + 2, len(self.record_names), self.lanes))
        message = ctypes.create_string_buffer(_MESSAGE_BYTES)
        failed = self._fly(
            *(start_time_s, len(names), self._references(names), values.reshape(-1)),
            *(step_s, steps, every, len(self._read), self._read, rows),
            *(message, _MESSAGE_BYTES),
        )
        if failed:
            raise FmuError(f"lanes: {message.value.decode(errors='replace')}")
        time_s = np.float64(start_time_s) + np.arange(0, steps + 1, every) * np.float64(step_s)
        return [
            Recording(self.record_names, time_s, rows[: len(time_s), :, lane].copy(), steps)
            for lane in range(len(starts))
        ]

    def _references(self, names: Sequence[str]) -> np.ndarray:
        """Value reference of each "slave.variable", shape (n,)."""
        ports = [self._interface.scalar(self._system.split(name)[1]) for name in names]
        return np.array([port.reference for port in ports], dtype=np.uint32)
