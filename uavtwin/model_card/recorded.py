"""What the folder of a model records of it: facts, training flights, envelope, limits."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from learning.force.laws import LAWS
from learning.model.registry import family_row
from twin.errors import TwinError
from twin.formatting import number

from .markdown import Table
from .measured import Result


def description(folder: Path) -> dict[str, Any]:
    """What the folder says of its model."""
    for name in ("force.json", "model.json"):
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
    """What the model is, name and value."""
    found = {"protocol": about["protocol"], "seed": str(about["seed"])}
    if about["protocol"] == "force":
        used = [f"{n} {o['law']}" for n, o in about["outputs"].items()]
        found |= {"laws": ", ".join(used)}
    else:
        row = family_row(about["family"])
        ahead = f"{about['horizon']} samples, {1e3 * about['horizon'] / about['rate_hz']:g} ms"
        found |= {
            **{"family": f"{row.name}: {row.meaning}", "preset": about["preset"]["name"]},
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


def _validation(about: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """By channel, on time kept out of the training: error of the linear prediction, and with the
    network; of channels that have such time."""
    said = about.get("metrics", {}).get("validation_mse", {})
    return {channel: errors for channel, errors in said.items() if errors["linear"] > 0}


def validation_table(about: Mapping[str, Any]) -> Table | None:
    """The same to show; None where there is none."""
    rows = [
        [channel, number(e["linear"]), number(e["with_network"])]
        for channel, e in _validation(about).items()
    ]
    return (["channel", "linear prediction", "with the network"], rows) if rows else None


def limits(about: Mapping[str, Any], result: Result | None) -> list[str]:
    """Where the model ends, as far as it is recorded."""
    flights, vehicle = about["flights"], about["vehicle"]
    found = [f"It has seen {len(flights)} flight{'s' * (len(flights) != 1)} of {vehicle}."]
    if about["protocol"] == "force":
        gone = about["closed_loop"]["withdrawn"]
        if gone:
            found.append(f"Withdrawn, as missions were lost with it: {', '.join(gone)}.")
        none = [n for n, o in about["outputs"].items() if o["law"] == LAWS[0]]
        if none:
            found.append(f"No law for {', '.join(none)}.")
    shut = [c for c, e in _validation(about).items() if e["with_network"] >= e["linear"]]
    if shut:
        found.append(
            f"The network adds nothing to the linear prediction in {', '.join(shut)}: its gates "
            "are shut there."
        )
    silent = [c for c in about.get("channels", ()) if _never_seen(about, c)]
    if silent:
        found.append(f"No reading in the training: {', '.join(silent)}.")
    if about["protocol"] == "reconstruct":
        found.append("It sees the measurement that it repeats; that itself leaves nothing.")
    if result is None:
        found.append("Nothing is known yet of flights that took no part in the training.")
    elif result.worse:
        found.append(f"Worse than a baseline: {'; '.join(result.worse)}.")
    return found


def _never_seen(about: Mapping[str, Any], channel: str) -> bool:
    """Whether a channel had no validation time, where the family keeps some."""
    said = about.get("metrics", {}).get("validation_mse", {})
    return bool(said) and said[channel]["linear"] == 0
