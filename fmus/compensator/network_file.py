"""`model.onnx` of a trained compensator: what it says about itself, held against its graph."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from twin.errors import FmuError
from twin.representation import short_repr

from ..names import LONGEST_NAME, check_identifier, check_name, check_text, shown
from ..units import base_exponents
from .graph import (
    INPUTS,
    MAX_FILE_BYTES,
    OUTPUTS,
    check_graph,
    parse_network,
    row_widths,
    take_one_sample,
)

FILE, INT8_FILE = "model.onnx", "model_int8.onnx"
"""In the folder of a trained model: as trained, and with weights of 8 bits."""
FORMAT = "uavtwin compensator 1"
PROTOCOLS = ("reconstruct", "track", "free")
MAX_CHANNELS, MAX_COMMANDS, MAX_PHASES, MAX_HORIZON = 64, 64, 64, 10_000
MAX_STATE = 50_000
"""Numbers of the packed state; the largest preset has 5,218."""
MAX_RATE_HZ = 1e5
MAX_TEXT = 255
"""Characters of a vehicle's name, which may be that of its file."""
MAX_METADATA = 2**20
"""Characters of one entry."""
_WAY_OUT = "Use a file that uavtwin train wrote"


@dataclass(frozen=True, slots=True)
class NetworkFile:
    """A compensator as its ONNX file describes it.

    Attributes:
        path: Of the file.
        content: Its bytes.
        channels: Virtual signals, as the twin names its outputs.
        units: Of the channels.
        groups: Sensors; each channel's name begins with one of them.
        commands: What drives the rotors, as the twin names its outputs.
        phases: Code of each phase.
        rate_hz: Samples per second.
        protocol: Which measurements it sees.
        horizon: Age of the newest one, samples.
        uncorrected_rms: What is to be expected without a correction, by channel.
        vehicle: Name of the twin's vehicle, "" where not said.
        vehicle_sha256: Of the vehicle's file, "" where not said.
        state_size: Numbers of the packed state.
    """

    path: Path
    content: bytes
    channels: tuple[str, ...]
    units: tuple[str, ...]
    groups: tuple[str, ...]
    commands: tuple[str, ...]
    phases: Mapping[str, int]
    rate_hz: float
    protocol: str
    horizon: int
    uncorrected_rms: tuple[float, ...]
    vehicle: str
    vehicle_sha256: str
    state_size: int

    __repr__ = short_repr

    @property
    def sees_measurements(self) -> bool:
        """Whether measured signals enter at all."""
        return self.protocol != "free"

    @property
    def group_of_channel(self) -> tuple[int, ...]:
        """Index of each channel's sensor."""
        return tuple(self.groups.index(c.rpartition("_")[0]) for c in self.channels)


def read_network(folder: Path, file: str = FILE) -> NetworkFile:
    """The network in the folder of a trained model, by the name of its file.

    The file may come from anywhere: names, sizes and numbers in it are checked before they are
    used, so that what is read can be written into an FMU.

    Raises:
        FmuError: There is none, it is damaged or foreign, something in it cannot stand in an FMU,
            or the package onnx is missing.
    """
    path = folder / file
    if not path.is_file():
        raise FmuError(
            f"{folder}: holds no {file}; give the folder that uavtwin train wrote, of a preset "
            f"that has an ONNX form (docs/guide/compensator.md)."
        )
    with path.open("rb") as opened:
        content = opened.read(MAX_FILE_BYTES + 1)
    model = parse_network(path, content)
    said = _Metadata(path, model.metadata_props)
    said.check_format(model.graph)
    take_one_sample(model)
    check_graph(path, model)
    network = _described(said, content, model.graph)
    _check_fit(said, network, model.graph)
    return network


class _Metadata:
    """The entries of a file, one kind of value per method; each refuses what is of another kind."""

    def __init__(self, path: Path, properties: Any) -> None:
        self.path = path
        self._texts: dict[str, str] = {}
        for entry in properties:
            if entry.key in self._texts:
                raise FmuError(f"{path}: metadata {shown(entry.key)} is there twice. {_WAY_OUT}.")
            self._texts[entry.key] = entry.value

    def check_format(self, graph: Any) -> None:
        """Whether the file is a compensator's and its graph as it was written.

        The checksum tells of damage, not of intent: an author of changes can mend it.
        """
        if self._texts.get("format") != FORMAT:
            raise FmuError(
                f"{self.path}: is no compensator ({FORMAT!r} is not among its metadata); give the "
                f"folder that uavtwin train wrote."
            )
        digest = hashlib.sha256(graph.SerializeToString(deterministic=True)).hexdigest()
        if self._texts.get("graph_sha256") != digest:
            raise FmuError(
                f"{self.path}: damaged or changed, its checksum does not fit; export it again."
            )

    def refuse(self, key: str, value: object, need: str) -> NoReturn:
        """Raise what says which entry is wrong and how."""
        raise FmuError(
            f"{self.path}: its metadata do not fit: {key} = {shown(value)}, {need}. {_WAY_OUT}."
        )

    def value(self, key: str) -> Any:
        """Of JSON, where NaN and infinity are none."""
        text = self._texts.get(key)
        if text is None:
            self.refuse(key, None, "the entry is missing")
        if len(text) > MAX_METADATA:
            self.refuse(key, text, f"{len(text)} characters are more than {MAX_METADATA}")
        try:
            return json.loads(text, parse_constant=_no_number)
        except (ValueError, RecursionError) as error:
            self.refuse(key, text, f"it is not JSON: {error}")

    def names(self, key: str, most: int) -> tuple[str, ...]:
        """1 to `most` identifiers, none twice."""
        values = self.list(key, most)
        where = f"{self.path}: {key}"
        names = tuple(check_identifier(where, v, LONGEST_NAME) for v in values)
        if len(set(names)) < len(names):
            self.refuse(key, values, "a name is there twice")
        return names

    def list(self, key: str, most: int) -> list[Any]:
        """1 to `most` values."""
        values = self.value(key)
        if not isinstance(values, list) or not 1 <= len(values) <= most:
            self.refuse(key, values, f"it must be a list of 1 to {most}")
        return values

    def text(self, key: str) -> str:
        """One line."""
        return check_text(f"{self.path}: {key}", self.value(key), MAX_TEXT)

    def whole(self, key: str, value: object, most: int) -> int:
        """A whole number from 0 on."""
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            self.refuse(key, value, f"it must be a whole number from 0 to {most}")
        return value

    def numbers(self, key: str, values: object, n: int, least: float) -> tuple[float, ...]:
        """So many finite numbers, each of them `least` or more."""
        if not isinstance(values, list) or len(values) != n:
            self.refuse(key, values, f"it must be a list of {n} numbers")
        for value in values:
            if not _is_number(value) or value < least:
                limit = "" if least == -math.inf else f" from {least:g} on"
                self.refuse(key, value, f"it must be a finite number{limit}")
        return tuple(map(float, values))


def _described(said: _Metadata, content: bytes, graph: Any) -> NetworkFile:
    """What the metadata say, in the words of the dataclass."""
    inputs = row_widths(graph.input)
    if tuple(inputs) != INPUTS:
        said.refuse("inputs of the graph", tuple(inputs), f"they must be {INPUTS}")
    channels = said.names("channels", MAX_CHANNELS)
    rate_hz = said.value("rate_hz")
    if not _is_number(rate_hz) or not 0 < rate_hz <= MAX_RATE_HZ:
        said.refuse("rate_hz", rate_hz, f"it must be above 0 and at most {MAX_RATE_HZ:g}")
    protocol = said.value("protocol")
    if protocol not in PROTOCOLS:
        said.refuse("protocol", protocol, f"it must be one of {', '.join(PROTOCOLS)}")
    digest = said.text("vehicle_sha256")
    if not re.fullmatch(r"[0-9a-f]{64}|", digest):
        said.refuse("vehicle_sha256", digest, "it must be empty or 64 digits of a hash")
    return NetworkFile(
        path=said.path,
        content=content,
        channels=channels,
        units=_units(said),
        groups=said.names("groups", MAX_CHANNELS),
        commands=said.names("commands", MAX_COMMANDS),
        phases=_phases(said),
        rate_hz=float(rate_hz),
        protocol=protocol,
        horizon=said.whole("horizon", said.value("horizon"), MAX_HORIZON),
        uncorrected_rms=said.numbers(
            "uncorrected_rms", said.value("uncorrected_rms"), len(channels), 0.0
        ),
        vehicle=said.text("vehicle"),
        vehicle_sha256=digest,
        state_size=inputs["state"],
    )


def _units(said: _Metadata) -> tuple[str, ...]:
    units = tuple(
        u.replace("²", "2") if isinstance(u, str) else u for u in said.list("units", MAX_CHANNELS)
    )
    for unit in units:
        try:
            base_exponents(unit)
        except (KeyError, TypeError):
            said.refuse("units", unit, "it must be a unit of fmus/units.py")
    return units


def _phases(said: _Metadata) -> dict[str, int]:
    """Codes 0, 1, 2, ... by name."""
    phases = said.value("phases")
    if not isinstance(phases, dict) or not 1 <= len(phases) <= MAX_PHASES:
        said.refuse("phases", phases, f"it must be 1 to {MAX_PHASES} codes by name")
    for name, code in phases.items():
        check_name(f"{said.path}: phases", name)
        said.whole(f"phases.{name}", code, len(phases) - 1)
    if len(set(phases.values())) < len(phases):
        said.refuse("phases", phases, "every phase needs a code of its own")
    return phases


def _check_fit(said: _Metadata, network: NetworkFile, graph: Any) -> None:
    """Whether metadata and graph say the same, and what the graph was scaled by is usable."""
    n, m, state = len(network.channels), len(network.commands), network.state_size
    if state > MAX_STATE:
        said.refuse("state of the graph", state, f"at most {MAX_STATE} numbers are kept")
    for names, found, widths in (
        (INPUTS, row_widths(graph.input), (n, m, 1, n, n, state)),
        (OUTPUTS, row_widths(graph.output), (n, n, 1, 1, state)),
    ):
        expected = dict(zip(names, widths, strict=True))
        if list(found.items()) != list(expected.items()):
            said.refuse("widths of the graph's tensors", found, f"they must be {expected}")
    if len(network.units) != n:
        said.refuse("units", network.units, f"there must be {n}, one per channel")
    for channel in network.channels:
        if channel.rpartition("_")[0] not in network.groups:
            said.refuse("channels", channel, f"it must begin with one of {network.groups} and _")
    taken = {"phase", "anomaly", "inside", "sample_period"}
    for name in (*network.channels, *network.commands):
        if name in taken:
            said.refuse("channels and commands", name, "this name is another signal's")
        taken.add(name)
    _check_normalisation(said, n, len(network.phases))


def _check_normalisation(said: _Metadata, n_channels: int, n_phases: int) -> None:
    """The numbers that are within the graph, as the file repeats them: finite, scales above 0."""
    tables = said.value("normalisation")
    if not isinstance(tables, dict):
        said.refuse("normalisation", tables, "it must be tables by name")
    tiny = math.ulp(0.0)
    for name, least in (("mean", -math.inf), ("scale", tiny)):
        key, rows = f"normalisation.{name}", tables.get(name)
        if not isinstance(rows, list) or len(rows) != n_phases:
            said.refuse(key, rows, f"it must have {n_phases} rows, one per phase")
        for row in rows:
            said.numbers(key, row, n_channels, least)
    centre = tables.get("feature_mean")
    n_features = len(centre) if isinstance(centre, list) else 0
    for name, least in (("feature_mean", -math.inf), ("feature_scale", tiny)):
        said.numbers(f"normalisation.{name}", tables.get(name), n_features, least)


def _is_number(value: object) -> bool:
    """Whether it is a number that a double holds."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -1.7e308 < value < 1.7e308


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")
