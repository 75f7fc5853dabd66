"""Result of a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.errors import FmuError
from twin.representation import ShortRepr

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Recording(ShortRepr):
    """Values at the communication points.

    Attributes:
        names: "slave.variable" of each column.
        time_s: Times, shape (n,).
        values: Values, shape (n, len(names)).
        steps: Communication steps taken.
        rejected: Steps rejected by the step-size control and repeated with shorter ones.
        lateness_s: Largest delay behind the clock, of a run in real time.
        incomplete: Reason why the run is incomplete; "" where it is complete.
        printed: Last part of the output printed by FMUs in a separate process.
    """

    names: tuple[str, ...]
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]
    steps: int = 0
    rejected: int = 0
    lateness_s: float = 0.0
    incomplete: str = ""
    printed: str = ""

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """One column by name."""
        return self.values[:, self.names.index(name)]

    def frame(self) -> "pd.DataFrame":
        """The recording as a table with `time` first; `attrs` state where it is incomplete."""
        import pandas as pd

        table = pd.DataFrame(self.values, columns=list(self.names))
        table.insert(0, "time", self.time_s)
        if self.incomplete:
            table.attrs["incomplete"] = self.incomplete
        return table

    def write(self, path: Path) -> None:
        """Write Parquet or CSV, chosen by the suffix; CSV keeps every bit (shortest repr).

        Parquet stores `incomplete`, too: pandas reads it into `attrs`.
        """
        if path.suffix == ".parquet":
            self.frame().to_parquet(path, index=False)
        elif path.suffix == ".csv":
            self.frame().to_csv(path, index=False)
        else:
            raise FmuError(f"{path.name}: recordings are written as .parquet or .csv.")


class RunError(FmuError):
    """An FMU failed while a system ran.

    Attributes:
        recording: Recording up to the failure.
    """

    def __init__(self, why: str, recording: Recording) -> None:
        super().__init__(why)
        self.recording = recording


class Interrupted(KeyboardInterrupt):
    """A run was interrupted between or during steps.

    Attributes:
        recording: Recording up to the interruption.
    """

    def __init__(self, recording: Recording) -> None:
        super().__init__(recording.incomplete)
        self.recording = recording
