"""Cards as files: beside a model when it is trained, beside the figures of an evaluation."""

from pathlib import Path

from .card import FILE, card_text
from .license import UNSAID, written_license
from .measured import Measured


def write_card(folder: Path, claim: str, license: str = UNSAID) -> str:
    """Write the card of a model that was trained just now; returns its name.

    Args:
        folder: That `train` wrote.
        claim: What the model is, in one sentence.
        license: Of the model.
    """
    (folder / FILE).write_text(card_text(folder, claim, license), "utf-8")
    return FILE


def write_completed_card(model: Path, claim: str, measured: Measured, folder: Path) -> str:
    """Write the card of a model that was measured; returns its name.

    Args:
        model: Folder of the model; the licence is that of its own card.
        claim: What the model is, in one sentence.
        measured: What was found.
        folder: Of the evaluation.
    """
    text = card_text(model, claim, written_license(model / FILE), measured)
    (folder / FILE).write_text(text, "utf-8")
    return FILE
