"""Experiments inside an FMU, with their reference outputs: read, rerun, compared.

Source: FMI Layered Standard References (FMI-LS-REF), draft 1.0.0-alpha.1, and the Experiments
Format of the Modelica Association, a draft without a version: its schema as of commit 2b88754 of
modelica/ma-hs-experiments, where the times are in `TransientSimulation`.

Neither defines how results are compared. Here `tolerance` of an experiment is the largest deviation
of an output over the largest magnitude of its reference, at the times of the reference.
"""

import csv
import hashlib
import io
import posixpath
import tempfile
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
from lxml import etree
from numpy.typing import NDArray

from twin.errors import FmuError

from .archive import Archive, open_archive, unpack
from .names import shown

Array = NDArray[np.float64]
Table = dict[str, Array]
"""Values by name, `time` in s first."""

VERSION = "1.0.0-alpha.1"
"""Version of FMI-LS-REF."""
NAME = "org.fmi-standard.fmi-ls-ref"
FOLDER = f"extra/{NAME}"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
TYPE = "application/x-ma-hs-experiments"
TOLERANCE = 1e-4
"""Tolerance in written files, and default of an experiment. Other processors and compilers deviate
less; a mass error of 3 % gives 1e-2. Made up."""
_ROLES = ("experiment", "experiment/smoke-test", "experiment/validation")
"""Roles of files with experiments that are rerun."""
_LEAST = 1e-9
"""Magnitude below which a reference counts as zero."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """An experiment to rerun.

    Attributes:
        name: Name of the experiment.
        start_s: Start time.
        stop_s: Stop time.
        step_s: Communication step.
        tolerance: Largest deviation over the largest magnitude of the reference.
        stimuli: Inputs over time; empty: they keep their start values.
        references: Outputs over time.
    """

    name: str
    start_s: float
    stop_s: float
    step_s: float
    tolerance: float
    stimuli: Table
    references: Table


@dataclass(frozen=True, slots=True)
class Deviation:
    """Deviation of a rerun from its reference.

    Attributes:
        experiment: Name of the experiment.
        output: Output with the largest relative deviation.
        share: Relative deviation; infinite: a value was NaN.
        tolerance: Tolerance of the experiment.
        outputs: Number of outputs compared.
        zero: Number of outputs whose reference is zero throughout: these hardly distinguish twins.
    """

    experiment: str
    output: str
    share: float
    tolerance: float
    outputs: int
    zero: int

    @property
    def passed(self) -> bool:
        """Whether all outputs are within the tolerance."""
        return self.share <= self.tolerance


def run(path: Path, experiment: Experiment, outputs: Iterable[str]) -> Table:
    """Outputs of an experiment at each of its steps, simulated by FMPy.

    Raises:
        FmuError: The FMU is unsafe, or the simulation fails.
    """
    stimuli = experiment.stimuli
    given = None
    if stimuli:
        given = np.zeros(len(stimuli["time"]), [(n, np.float64) for n in stimuli])
        for name, values in stimuli.items():
            given[name] = values
    wanted = list(outputs)
    with tempfile.TemporaryDirectory() as folder:
        unpack(path, Path(folder))
        try:
            found = fmpy.simulate_fmu(
                folder,
                start_time=experiment.start_s,
                stop_time=experiment.stop_s,
                output_interval=experiment.step_s,
                fmi_type="CoSimulation",
                input=given,
                output=wanted,
            )
        except Exception as error:  # FMPy raises many kinds
            raise FmuError(f"{path.name}: {experiment.name} cannot be run: {error}") from error
    if unknown := [name for name in wanted if name not in found.dtype.names]:
        raise FmuError(
            f"{path.name}: {experiment.name}: no output {', '.join(map(shown, unknown))}."
        )
    return {name: np.asarray(found[name], float) for name in ("time", *wanted)}


def verify(path: Path) -> list[Deviation]:
    """Rerun every experiment in an FMU.

    Raises:
        FmuError: It has none, they cannot be read or their checksums differ from its manifest, or
            the FMU cannot be run.
    """
    archive = open_archive(path)
    experiments = read_experiments(archive)
    if not experiments:
        raise FmuError(
            f"{path.name}: holds no reference results (FMI-LS-REF). Export it without --arrays and "
            f"--python-slave, which leave them out."
        )
    if problems := related_problems(archive):
        raise FmuError(
            f"{path.name}: {'; '.join(problems)}: it would be compared with something else. Export "
            f"it again, or take the file as it was sent."
        )
    return [
        _deviation(e, run(path, e, [n for n in e.references if n != "time"])) for e in experiments
    ]


def _deviation(experiment: Experiment, found: Table) -> Deviation:
    """The output with the largest relative deviation."""
    at = experiment.references["time"]
    shares: dict[str, float] = {}
    for name, wanted in experiment.references.items():
        if name == "time":
            continue
        off = np.abs(np.interp(at, found["time"], found[name]) - wanted).max()
        share = off / max(float(np.abs(wanted).max()), _LEAST)
        shares[name] = float(share) if np.isfinite(share) else np.inf
    worst = max(shares, key=shares.__getitem__)
    zero = sum(not experiment.references[name].any() for name in shares)
    return Deviation(experiment.name, worst, shares[worst], experiment.tolerance, len(shares), zero)


def related_problems(archive: Archive) -> list[str]:
    """Files of the manifest that are missing, or have another checksum."""
    problems = []
    with zipfile.ZipFile(archive.path) as opened:
        for element in _related(archive, opened):
            member = _member(MANIFEST, element.get("source", ""))
            wanted = element.get("checksum")
            kind = element.get("checksumType", "SHA3-256").lower().replace("sha-", "sha")
            if member not in archive.names:
                problems.append(f"{MANIFEST} names {shown(member)}, which is not there")
            elif wanted is not None:
                kind = kind.replace("sha3-", "sha3_")
                if kind not in hashlib.algorithms_guaranteed or kind.startswith("shake"):
                    problems.append(f"{shown(member)}: checksums of {shown(kind)} are not read")
                elif not _has(kind, wanted, _content(archive, opened, member)):
                    problems.append(f"{shown(member)} has another checksum than {MANIFEST} says")
    return problems


def read_experiments(archive: Archive) -> list[Experiment]:
    """Experiments of an FMU, in order; none: it has no manifest, or no experiments.

    Raises:
        FmuError: They cannot be read, or need more than inputs, times and references.
    """
    found = []
    with zipfile.ZipFile(archive.path) as opened:
        for element in _related(archive, opened):
            if element.get("role") in _ROLES and element.get("type") == TYPE:
                member = _member(MANIFEST, element.get("source", ""))
                root = _parsed(archive, opened, member)
                found += [_experiment(archive, opened, member, e) for e in root.iter("Experiment")]
    return found


def _related(archive: Archive, opened: zipfile.ZipFile) -> list[etree._Element]:
    if archive.problems or MANIFEST not in archive.names:
        return []
    return list(_parsed(archive, opened, MANIFEST).iter("Related"))


def _experiment(
    archive: Archive, opened: zipfile.ZipFile, member: str, element: etree._Element
) -> Experiment:
    name, times = element.get("name", ""), element.find("TransientSimulation")
    where = f"{archive.path.name}: {member}: {shown(name)}"
    references = element.find("References")
    if times is None or references is None or element.find("Parameters") is not None:
        raise FmuError(
            f"{where}: only a TransientSimulation with References and without Parameters is rerun."
        )

    def table(part: etree._Element | None) -> Table:
        """Columns named by a part of the experiment; {} without one."""
        if part is None:
            return {}
        if part.get("type", "text/csv") != "text/csv":
            raise FmuError(f"{where}: {part.get('type')} is not read; text/csv is.")
        return _table(archive, opened, _member(member, part.get("source", "")))

    try:
        numbers = [float(times.get(k, d)) for k, d in (("startTime", "0"), ("stopTime", "nan"))]
        numbers.append(float(times.get("stepSize", "nan")))
        tolerance = float(element.get("tolerance", TOLERANCE))
    except ValueError as error:
        raise FmuError(f"{where}: {error}.") from None
    start, stop, step = numbers
    if not (np.isfinite(start) and start < stop < np.inf and 0 < step <= stop - start):
        raise FmuError(f"{where}: from {start} to {stop} in steps of {step} is no experiment.")
    wanted = table(references)
    if len(wanted) < 2:
        raise FmuError(f"{where}: its references hold no output.")
    if not 0 < tolerance < 1:
        raise FmuError(
            f"{where}: a tolerance of {tolerance} is none: with 1 or more, zeros would pass."
        )
    return Experiment(name, start, stop, step, tolerance, table(element.find("Stimuli")), wanted)


def _table(archive: Archive, opened: zipfile.ZipFile, member: str) -> Table:
    """Columns of a CSV file; the first is the time."""
    try:
        rows = list(csv.reader(io.StringIO(_content(archive, opened, member).decode())))
        values = np.array(rows[1:], float)
        columns = dict(zip(["time", *rows[0][1:]], values.T, strict=True))
    except (IndexError, ValueError) as error:
        raise FmuError(f"{archive.path.name}: {shown(member)}: no table: {error}.") from None
    if not len(columns["time"]) or not np.isfinite(values).all():
        raise FmuError(f"{archive.path.name}: {shown(member)}: no rows, or no finite numbers.")
    return columns


def _member(base: str, source: str) -> str:
    """Name in the archive of a file that is referenced relative to another one."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(base), source))


def _has(kind: str, checksum: str, content: bytes) -> bool:
    return hashlib.new(kind, content).hexdigest() == checksum.lower()


def _content(archive: Archive, opened: zipfile.ZipFile, member: str) -> bytes:
    """Content of a member.

    Raises:
        FmuError: It is missing, or damaged.
    """
    try:
        return opened.read(member)
    except Exception as error:  # zipfile, zlib and lzma raise many kinds on damaged files
        raise FmuError(f"{archive.path.name}: {shown(member)}: {error}.") from None


def _parsed(archive: Archive, opened: zipfile.ZipFile, member: str) -> etree._Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    try:
        return etree.fromstring(_content(archive, opened, member), parser)
    except etree.XMLSyntaxError as error:
        raise FmuError(f"{archive.path.name}: {shown(member)}: {error}.") from None
