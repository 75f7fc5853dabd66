"""The model card of a trained folder: a README.md with Hugging Face's head.

Nothing stands in it that the folder or an evaluation does not record: `model.json` or `force.json`,
and the content of `evaluation.json`.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import yaml

from .license import UNSAID
from .markdown import plain, table
from .measured import Measured, Result, evaluated, inside_table, result_of
from .recorded import (
    description,
    envelope,
    facts,
    limits,
    trained_on,
    training_table,
    validation_table,
)

FILE = "README.md"
_USES = {
    "track": "corrects what the twin's sensors read, from residuals as old as the horizon",
    "free": "corrects what the twin's sensors read, without seeing a measurement",
    "reconstruct": "repeats the measurement that it is given; for comparison with the paper alone",
    "generate": "draws what sensors might have read besides; it corrects nothing",
    "force": "adds force and moment to the equations of the twin",
}


def card_text(
    folder: Path, claim: str, license: str = UNSAID, measured: Measured | None = None
) -> str:
    """Text of a card.

    Args:
        folder: That `train` wrote.
        claim: What the model is, in one sentence.
        license: Of the model, as Hugging Face names it.
        measured: On flights of its own; None: not yet.
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
        loader=jinja2.PackageLoader("uavtwin.model_card", "templates"),
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # Markdown: texts pass `plain`
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["plain"] = plain
    text = environment.get_template("card.md.j2").render(
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
    """What the model is and of what."""
    kind = {"force": "Learned force", "generate": "Generator"}.get(about["protocol"], "Compensator")
    return f"{kind} for {about['vehicle']}"


def _tags(folder: Path, about: Mapping[str, Any]) -> list[str]:
    """Words to find it by."""
    own = ["digital-twin", "multirotor", about["protocol"]]
    return (
        own
        + ([about["family"]] if "family" in about else [])
        + (["onnx"] if (folder / "model.onnx").is_file() else [])
    )


def _indexed(about: Mapping[str, Any], measured: Measured, result: Result) -> dict[str, Any]:
    """The figures as Hugging Face indexes them."""
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
