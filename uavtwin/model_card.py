"""The model card of a trained model's folder: a README.md with Hugging Face's header.

It contains only facts recorded in the folder or an evaluation: `model.json` or `force.json`, and
the content of `evaluation.json`. It is written after training, and completed with the results of an
evaluation.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from operator import itemgetter
from pathlib import Path
from typing import Any

import jinja2
import yaml

from learning.force.model import LINEAR, NONE
from learning.model.registry import family_named
from twin.errors import TwinError
from twin.formatting import number, percent

Table = tuple[list[str], list[list[str]]]
"""Header and rows."""


def plain(text: Any) -> str:
    """A text from a file as one cell of Markdown: no markup, no line ends, no other cell."""
    one_line = " ".join(str(text).split())
    return re.sub(r"([\\`*\[\]<>|&])", r"\\\1", one_line)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown; texts pass `plain`."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(c if c == "---" else plain(c) for c in line) + " |" for line in lines
    )


UNSAID = "unknown"
"""Hugging Face's identifier for an unknown licence."""
_LICENSE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]{0,60}")
"""Identifiers as of Hugging Face's list."""
_HEAD = re.compile(r"---\n(.*?)\n---\n", re.DOTALL)
"""YAML between two lines of hyphens, at the top of the file."""


def check_license(name: object) -> str:
    """The name of a licence, if it can be one.

    Raises:
        TwinError: It cannot.
    """
    if not isinstance(name, str) or not _LICENSE.fullmatch(name):
        raise TwinError(
            f"license {name!r}: give an identifier of letters, digits, dots and hyphens, e.g. "
            "cc-by-4.0 or other."
        )
    return name


def written_license(card: Path) -> str:
    """The licence in the header of a card; `unknown` without one.

    Args:
        card: Markdown with a YAML head; it may not be there, and others may have written it.

    Raises:
        TwinError: Its head is no YAML, or what it names cannot be a licence.
    """
    if not card.is_file():
        return UNSAID
    head = _HEAD.match(card.read_text("utf-8", "replace"))
    try:
        content = yaml.safe_load(head[1]) if head else None
        return check_license(
            content.get("license", UNSAID) if isinstance(content, dict) else UNSAID
        )
    except (yaml.YAMLError, TwinError, RecursionError, ValueError) as error:
        raise TwinError(f"{card}: its head cannot be read: {error}") from error


CORRECTED, ALONE = "model", "linear part alone"
"""Names of a compensator, and of it without its network, in the rows of an evaluation."""
SHIPPED = "corrected"
"""Name of the twin with a learned force in these rows."""
CLAIMED_S = 0.5
"""Horizon of the results for a learned force."""
_SHARES = ("within_1", "within_2", "inside")
"""Columns of the calibration of the spread."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Result of `uavtwin evaluate`.

    Attributes:
        content: Content of `evaluation.json`.
        hashes: `Flight.fingerprint` by the name of a flight.
    """

    content: Mapping[str, Any]
    hashes: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Result:
    """Figures of an evaluation.

    Attributes:
        caption: Caption of the table.
        table: Models alongside each other.
        metrics: Metrics of the model itself: `type`, `name`, `value`.
        worse: One text per metric in which a baseline is better.
        spread: Coverage of the predicted spread; None: the model predicts none.
    """

    caption: str
    table: Table
    metrics: tuple[dict[str, Any], ...]
    worse: tuple[str, ...]
    spread: Table | None = None


def result_of(protocol: str, measured: Measured) -> Result:
    """The table of an evaluation, and the figures of the model itself."""
    content = measured.content
    if protocol == "force":
        return _force_result(content)
    groups: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in content["groups"]:
        groups.setdefault(row["group"], {})[row["model"]] = row
    models = list(dict.fromkeys(row["model"] for row in content["groups"]))
    others = [m for m in models if m not in (CORRECTED, ALONE)]
    rows, worse = [], []
    metrics: list[dict[str, Any]] = []
    for group, cells in groups.items():
        left = {m: _known(cells[m]["rmse"]) for m in models}
        shown = cells[CORRECTED]["unit"]
        rows.append([group, shown, *(number(left[m]) for m in models)])
        metrics.append({"type": "rmse", "name": f"{group}, {shown}", "value": left[CORRECTED]})
        best, least = min(((m, left[m]) for m in others if isfinite(left[m])), key=itemgetter(1))
        if left[CORRECTED] > least:
            text = f"{best} leaves {number(least)}, it {number(left[CORRECTED])}"
            worse.append(f"{group}: {text} {shown}")
    shares = [
        [group, *(percent(_known(cells[CORRECTED][k])) for k in _SHARES)]
        for group, cells in groups.items()
        if _SHARES[0] in cells[CORRECTED]
    ]
    return Result(
        "Rms of the residual that is left",
        (["sensor", "unit", *models], rows),
        tuple(m for m in metrics if isfinite(m["value"])),
        tuple(worse),
        (["sensor", "within one", "within two", "inside"], shares) if shares else None,
    )


def _force_result(content: Mapping[str, Any]) -> Result:
    """Table of a learned force: errors of twins over the time without given motion."""
    quantities = {"position": "m", "velocity": "m/s", "attitude": "rad", "rates": "rad/s"}
    summed = [r for r in content["summary"] if r["horizon_s"] == CLAIMED_S]
    own = next(r for r in summed if r["model"] == SHIPPED)
    metrics = [
        {"type": "rmse", "name": f"{q} after {CLAIMED_S:g} s, {u}", "value": own[q]}
        for q, u in quantities.items()
    ]
    for kind in ("median", "largest"):
        name = f"over the explained twin after {CLAIMED_S:g} s, {kind} cell"
        metrics.append(
            {"type": "ratio", "name": name, "value": _known(own[f"over_explained_{kind}"])}
        )
    best = {q: min(summed, key=itemgetter(q)) for q in quantities}
    worse = [
        f"{q}: {r['model']} is off by {number(r[q])}, it by {number(own[q])}"
        for q, r in best.items()
        if r[q] < own[q]
    ]
    return Result(
        f"Rms by which a twin is off {CLAIMED_S:g} s after it was left alone",
        (
            ["twin", *(f"{q}, {u}" for q, u in quantities.items())],
            [[r["model"], *(number(r[q]) for q in quantities)] for r in summed],
        ),
        tuple(m for m in metrics if isfinite(m["value"])),
        tuple(worse),
    )


def inside_table(content: Mapping[str, Any]) -> Table | None:
    """Table of how often a learned force was inside its envelope; None for other models."""
    if "inside" not in content:
        return None
    header = ["flight", *(f"after {h:g} s" for h in content["horizons_s"])]
    return header, [[f, *(percent(s) for s in shares)] for f, shares in content["inside"].items()]


def evaluated(measured: Measured) -> list[list[str]]:
    """Flights of an evaluation, by hash."""
    return [[name, measured.hashes[name]] for name in measured.content["flights"]]


def _known(value: float | None) -> float:
    """A figure of JSON; NaN where it is not defined."""
    return nan if value is None else value


def description(folder: Path) -> dict[str, Any]:
    """Content of the model's JSON file."""
    for name in ("model.json", "force.json"):
        if (folder / name).is_file():
            found: dict[str, Any] = json.loads((folder / name).read_text("utf-8"))
            return found
    raise TwinError(f"{folder}: holds no model; a model is what `uavtwin train` wrote.")


def trained_on(flight: Mapping[str, Any]) -> dict[str, Any]:
    """A flight of the training by its hashes: that of the flight, and of the residuals made of
    it."""
    if "log_sha256" not in flight:
        return {"name": flight["name"], "sha256": flight["sha256"]}
    return {
        "name": flight["name"],
        "sha256": flight["log_sha256"],
        "residuals_sha256": flight["sha256"],
        "samples": flight["samples"],
        "seconds": flight["seconds"],
    }


def facts(about: Mapping[str, Any]) -> list[list[str]]:
    """Facts of the model, name and value."""
    found = {"protocol": about["protocol"], "seed": str(about["seed"])}
    if about["protocol"] == "force":
        laws = {n: o["ridge"] for n, o in about["outputs"].items()}
        used = [f"{n} linear, ridge {r:g}" for n, r in laws.items() if r is not None]
        others = {o["law"] for o in about["outputs"].values()} - {LINEAR}
        found |= {"law": ", ".join([*used, *sorted(others)])}
    else:
        family = family_named(about["family"])
        ahead = f"{about['horizon']} samples, {1e3 * about['horizon'] / about['rate_hz']:g} ms"
        found |= {
            **{"family": f"{family.name}: {family.meaning}", "preset": about["preset"]["name"]},
            **({"horizon": ahead} if about["protocol"] == "track" else {}),
            **{"rate": f"{about['rate_hz']:g} Hz", "motors": str(about["n_commands"])},
            "channels": ", ".join(about["channels"]),
            "clusters": "; ".join(", ".join(c) for c in about["clusters"]) or "none",
        }
    return [[k, v] for k, v in found.items()]


def training_table(about: Mapping[str, Any]) -> Table:
    """Flights of the training."""
    flights = [trained_on(f) for f in about["flights"]]
    if all("seconds" in f for f in flights):
        rows = [[f["name"], str(f["samples"]), f"{f['seconds']:g}", f["sha256"]] for f in flights]
        return ["flight", "samples", "seconds", "sha256"], rows
    return ["flight", "sha256"], [[f["name"], f["sha256"]] for f in flights]


def envelope(about: Mapping[str, Any]) -> Table | None:
    """Inputs in which the envelope is a distance; None where the model has none."""
    said = about.get("envelope") or {}
    if not said:
        return None
    each = zip(said["inputs"], said["centre"], said["scale"], strict=True)
    return ["input", "centre", "scale"], [[n, number(c), number(s)] for n, c, s in each]


def validation_errors(about: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """Validation error of the linear prediction and of the network, by channel; only channels with
    time kept out of the training."""
    said = about.get("metrics", {}).get("validation_mse", {})
    return {channel: errors for channel, errors in said.items() if errors["linear"] > 0}


def validation_table(about: Mapping[str, Any]) -> Table | None:
    """These errors in display form; None where there are none."""
    rows = [
        [channel, number(e["linear"]), number(e["with_network"])]
        for channel, e in validation_errors(about).items()
    ]
    return (["channel", "linear prediction", "with the network"], rows) if rows else None


def limits(about: Mapping[str, Any], result: Result | None) -> list[str]:
    """Known limits of the model, one sentence each."""
    flights, vehicle = about["flights"], about["vehicle"]
    found = [f"It has seen {len(flights)} flight{'s' * (len(flights) != 1)} of {vehicle}."]
    if about["protocol"] == "force":
        if gone := about["closed_loop"]["withdrawn"]:
            found.append(f"Missions were lost with {gone} better laws: withdrawn.")
        if gone := about["closed_loop"]["unsteady"]:
            found.append(f"With {gone} better laws the twin swings in a hover: withdrawn.")
        if about["acceptance"]["refused"]:
            found.append("Refused: the untrained observer alone is as good.")
        if (about["acceptance"]["fast"] or 0.0) >= 1:
            found.append("On fast flights the last motion is closer after half a second.")
        if all(o["law"] == NONE for o in about["outputs"].values()):
            found.append("It has no law: what is shipped is the twin with its observer.")
    shut = [c for c, e in validation_errors(about).items() if e["with_network"] >= e["linear"]]
    if shut:
        found.append(
            f"The network adds nothing to the linear prediction in {', '.join(shut)}: its gates "
            "are shut there."
        )
    silent = [c for c in about.get("channels", ()) if _without_samples(about, c)]
    if silent:
        found.append(f"No reading in the training: {', '.join(silent)}.")
    if about["protocol"] == "reconstruct":
        found.append("It sees the measurement that it repeats; that itself leaves nothing.")
    if result is None:
        found.append("Nothing is known yet of flights that took no part in the training.")
    elif result.worse:
        found.append(f"Worse than a baseline: {'; '.join(result.worse)}.")
    return found


def _without_samples(about: Mapping[str, Any], channel: str) -> bool:
    """Whether a channel had no validation time, where the family keeps some."""
    said = about.get("metrics", {}).get("validation_mse", {})
    return bool(said) and said[channel]["linear"] == 0


FILE = "README.md"  # in the folder of a model
_USES = {
    "track": "corrects what the twin's sensors read, from residuals as old as the horizon",
    "free": "corrects what the twin's sensors read, without seeing a measurement",
    "reconstruct": "repeats the measurement that it is given; for comparison with the paper alone",
    "force": "adds force and moment to the equations of the twin",
}
"""Purpose of a model by protocol."""


def card_text(
    folder: Path, claim: str, license: str = UNSAID, measured: Measured | None = None
) -> str:
    """Text of a card.

    Args:
        folder: Folder that `train` wrote.
        claim: Purpose of the model, in one sentence.
        license: License of the model, as Hugging Face names it.
        measured: Evaluation on other flights; None: not yet.
    """
    about = description(folder)
    result = None if measured is None else result_of(about["protocol"], measured)
    head: dict[str, Any] = {
        "license": license,
        "library_name": "uavtwin",
        "tags": _tags(folder, about),
        "vehicle": {"name": about["vehicle"], "sha256": about["vehicle_sha256"]},
        "training_flights": [trained_on(f) for f in about["flights"]],
    }
    if measured is not None and result is not None:
        head["metrics"] = list(dict.fromkeys(m["type"] for m in result.metrics))
        head["model-index"] = [
            {"name": _title(about), "results": [_indexed(about, measured, result)]}
        ]
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uavtwin.report", "templates"),
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # Markdown: texts pass `plain`
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["plain"] = plain
    text = environment.get_template("model_card.md.j2").render(
        **{"head": _yaml(head), "title": _title(about), "claim": claim, "about": about},
        **{"force": about["protocol"] == "force", "use": _USES[about["protocol"]]},
        **{"license": license, "unsaid": license == UNSAID, "table": table},
        onnx=(folder / "model.onnx").is_file(),
        facts=facts(about),
        training=training_table(about),
        envelope=envelope(about),
        validation=validation_table(about),
        measured=measured,
        result=result,
        inside=None if measured is None else inside_table(measured.content),
        evaluated=[] if measured is None else evaluated(measured),
        limits=limits(about, result),
    )
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _yaml(content: Mapping[str, Any]) -> str:
    """The head of a card, its marks included."""
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=math.inf)
    return f"---\n{text}---"


def _title(about: Mapping[str, Any]) -> str:
    """Summary of the model."""
    kind = "Learned force" if about["protocol"] == "force" else "Compensator"
    return f"{kind} for {about['vehicle']}"


def _tags(folder: Path, about: Mapping[str, Any]) -> list[str]:
    """Keywords for search."""
    own = ["digital-twin", "multirotor", about["protocol"]]
    return (
        own
        + ([about["family"]] if "family" in about else [])
        + (["onnx"] if (folder / "model.onnx").is_file() else [])
    )


def _indexed(about: Mapping[str, Any], measured: Measured, result: Result) -> dict[str, Any]:
    """The results in Hugging Face's index form."""
    names = list(measured.content["flights"])
    return {
        "task": {"type": "time-series-forecasting", "name": about["protocol"]},
        "dataset": {
            "type": "flights",
            "name": ", ".join(names),
            "args": {"sha256": [measured.hashes[n] for n in names]},
        },
        "metrics": list(result.metrics),
    }


def write_card(folder: Path, claim: str, license: str = UNSAID) -> str:
    """Write the card of a newly trained model; returns its name.

    Args:
        folder: Folder that `train` wrote.
        claim: Purpose of the model, in one sentence.
        license: License of the model.
    """
    (folder / FILE).write_text(card_text(folder, claim, license), "utf-8")
    return FILE


def write_completed_card(model: Path, claim: str, measured: Measured, folder: Path) -> str:
    """Write the card of an evaluated model; returns its name.

    Args:
        model: Folder of the model; the licence is that of its own card.
        claim: Purpose of the model, in one sentence.
        measured: Result of the evaluation.
        folder: Folder of the evaluation.
    """
    text = card_text(model, claim, written_license(model / FILE), measured)
    (folder / FILE).write_text(text, "utf-8")
    return FILE
