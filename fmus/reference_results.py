"""Reference results of a built FMU: its outputs on the building machine, in the format of
`experiments`."""

import csv
import hashlib
import io
import re
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from lxml import etree

from twin.component import Variable

from .builder import build, extend_archive
from .description import xml_bytes
from .experiments import (
    FOLDER,
    MANIFEST,
    NAME,
    TOLERANCE,
    TYPE,
    VERSION,
    Array,
    Experiment,
    Table,
    run,
)
from .model import FmuModel
from .names import usual_size
from .platforms import DEFAULT

_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
_ABOUT = "Layered Standard providing information on related files included in an FMU."
_CLOSED, _OPEN = (5.0, 0.05), (1.0, 0.02)
"""Stop time and step, s: of a closed loop, long enough for a take-off, and of a component with
external inputs. Made up: without a controller a Crazyflie tumbles, and a change of its inputs of
1e-12 grows to 1e-6 of the result after 1 s and to all of it after 5 s."""
_MOTOR = re.compile(r"(^|\.)(cmd|rotor)_\d+$")  # rotor input
_DIGITS = 9
"""Significant digits of a number: four more than `TOLERANCE` requires."""
_EXCITED = 0.02
"""Amplitude of an input over its typical magnitude. Made up: the response remains near the
start."""


def add_reference_results(path: Path, model: FmuModel, fmi: int) -> None:
    """Run an FMU written by `build`, and add experiment and outputs to it.

    Args:
        path: Path of the FMU, which is replaced.
        model: Model of the FMU; without arrays.
        fmi: FMI version.
    """
    inputs = [v for v in model.variables if v.causality == "input"]
    stop_s, step_s = _OPEN if any(_MOTOR.search(v.name) for v in inputs) else _CLOSED
    time = np.array([float(_number(k * step_s)) for k in range(round(stop_s / step_s) + 1)])
    experiment = Experiment(
        "made_up", 0.0, stop_s, step_s, TOLERANCE, _stimuli(inputs, time), {"time": time}
    )
    with tempfile.TemporaryDirectory() as folder:
        runnable = Path(folder, path.name)
        build(model, runnable, fmi, DEFAULT)  # from the cache, if it is for this platform
        found = run(runnable, experiment, model.output_names)
    extend_archive(path, _members(experiment, found))


def _stimuli(inputs: Iterable[Variable], time: Array) -> Table:
    """Real inputs around their start values, each with its own frequency; others constant, or at
    their usual value from the first step on.

    Numbers are rounded as in the file.
    """
    waves: Table = {}
    for k, v in enumerate(inputs):
        size = _EXCITED * usual_size(v) if v.real else 0.0
        wave = float(v.start) + size * np.sin(2 * np.pi * (0.3 + 0.07 * k) * time)
        if not v.real and v.nominal is not None:
            wave = np.where(time > 0.0, v.nominal, wave)
        waves[v.name] = np.array([float(_number(x)) for x in wave])
    return {"time": time, **waves} if waves else {}


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _members(experiment: Experiment, found: Table) -> dict[str, bytes]:
    """Files of the layered standard."""
    files = {"reference_out.csv": (_csv(found), "text/csv", "result", "Outputs of made_up")}
    if experiment.stimuli:
        files["reference_in.csv"] = (
            *(_csv(experiment.stimuli), "text/csv", "other"),
            "Inputs of made_up: around their start values, held between two rows",
        )
    files["reference.exp"] = (
        *(_experiments(experiment), TYPE, "experiment/smoke-test"),
        "What this FMU gave where it was built: rerun it to see that it gives the same here",
    )
    manifest = etree.Element("fmiReferences", nsmap={"fmi-ls": _NAMESPACE})
    for key, text in (("name", NAME), ("version", VERSION), ("description", _ABOUT)):
        manifest.set(f"{{{_NAMESPACE}}}fmi-ls-{key}", text)
    for name, (content, kind, role, description) in files.items():
        etree.SubElement(
            manifest,
            "Related",
            type=kind,
            source=name,
            role=role,
            description=description,
            checksum=hashlib.sha3_256(content).hexdigest(),
            checksumType="SHA3-256",
        )
    about = (
        f"Reference results, FMI-LS-REF {VERSION} (draft), in {FOLDER}.\n\n"
        f"made_up: {experiment.stop_s:g} s from the start values, inputs as reference_in.csv has "
        "them, where there are some.\nIt is no flight: it shows that the FMU computes here what it "
        "computed where it was built.\n"
        f"An output passes if it is nowhere farther from its reference than {TOLERANCE:g} of the "
        "reference's largest magnitude.\n\nuavtwin verify FILE reruns it.\n"
    )
    return {
        MANIFEST: xml_bytes(manifest),
        "documentation/fmi-ls-ref.txt": about.encode(),
        **{f"{FOLDER}/{name}": content for name, (content, *_) in files.items()},
    }


def _experiments(experiment: Experiment) -> bytes:
    root = etree.Element("Experiments", name="smoke test")
    one = etree.SubElement(
        root, "Experiment", name=experiment.name, tolerance=_number(experiment.tolerance)
    )
    etree.SubElement(
        one,
        "TransientSimulation",
        startTime=_number(experiment.start_s),
        stopTime=_number(experiment.stop_s),
        stepSize=_number(experiment.step_s),
    )
    if experiment.stimuli:
        etree.SubElement(one, "Stimuli", type="text/csv", source="reference_in.csv")
    etree.SubElement(one, "References", type="text/csv", source="reference_out.csv")
    return xml_bytes(root)


def _csv(table: Mapping[str, Array]) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(table)
    rows.writerows([_number(x) for x in row] for row in zip(*table.values(), strict=True))
    return text.getvalue().encode()
