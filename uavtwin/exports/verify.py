"""Verification of an FMU by rerunning its reference results."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.experiments import Deviation
from fmus.experiments import verify as rerun
from twin.errors import TwinError

from ..display import DisplayMixin, TextTable
from ..record import Record


class ExperimentRecord(Record, frozen=True, kw_only=True):
    """An experiment of an FMU, and its deviation from the reference.

    Attributes:
        name: Name of the experiment.
        passed: Whether every output is within the tolerance.
        outputs: Number of outputs compared.
        zero: Number of outputs whose reference is zero throughout: these hardly distinguish twins.
        worst: Output with the largest relative deviation.
        deviation: Deviation of that output, over the largest magnitude of its reference; null: NaN.
        tolerance: Tolerance of the experiment.
    """

    name: str
    passed: bool
    outputs: int
    zero: int
    worst: str
    deviation: float
    tolerance: float


class VerifyRecord(Record, frozen=True, kw_only=True):
    """Record of `verify`.

    Attributes:
        file: Name of the FMU or .ssp.
        passed: Whether all experiments passed.
        experiments: Experiments in the order of the FMU; of an .ssp with the part's name as prefix.
        error: Reason why it could not be rerun; empty: it was.
    """

    file: str
    passed: bool
    experiments: tuple[ExperimentRecord, ...]
    error: str = ""


@dataclass(frozen=True, slots=True, repr=False)
class VerifyResult(DisplayMixin):
    """Result of `verify`.

    Attributes:
        file: Name of the FMU or .ssp.
        deviations: One deviation per experiment.
    """

    file: str
    deviations: tuple[Deviation, ...]

    @property
    def passed(self) -> bool:
        """Whether all experiments passed."""
        return all(d.passed for d in self.deviations)

    @property
    def record(self) -> VerifyRecord:
        """The content of `--json`."""
        experiments = tuple(
            ExperimentRecord(
                name=d.experiment,
                passed=d.passed,
                outputs=d.outputs,
                zero=d.zero,
                worst=d.output,
                deviation=d.share,
                tolerance=d.tolerance,
            )
            for d in self.deviations
        )
        return VerifyRecord(file=self.file, passed=self.passed, experiments=experiments)

    def findings(self) -> Iterable[str | TextTable]:
        """A sentence per experiment."""
        for d in self.deviations:
            said = "comes out the same" if d.passed else "comes out otherwise"
            yield (
                f"{self.file}: experiment {d.experiment} {said}: of {d.outputs} outputs, "
                f"{d.zero} zero throughout, {d.output} is most off, {d.share:.2g} of its reference "
                f"({d.tolerance:g} allowed)."
            )

    def brief(self) -> str:
        """Text on whether it passed."""
        return f"{type(self).__name__}: {self.file}, {'passed' if self.passed else 'failed'}"


def verify(path: str | Path) -> VerifyResult:
    """Rerun the experiments of an FMU, or of each in an .ssp, and compare the outputs.

    Their code is executed.

    Raises:
        TwinError: There is no such file; one has no reference results, or cannot be run.
    """
    path = Path(path)
    if not path.is_file():
        raise TwinError(f"{path}: no such file.")
    if path.suffix != ".ssp":
        return VerifyResult(path.name, tuple(rerun(path)))
    from cosim.ssp import read_ssp

    system = read_ssp(path)  # its files exist as long as it does
    found = [
        replace(d, experiment=f"{name}.{d.experiment}", output=f"{name}.{d.output}")
        for name, fmu in system.fmus.items()
        for d in rerun(fmu)
    ]
    return VerifyResult(path.name, tuple(found))
