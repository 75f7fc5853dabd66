"""Cards in the folders of models: written by training, completed by evaluation, edits kept."""

import hashlib
import re
from pathlib import Path

from twin.errors import TwinError

from ..output import output_file
from .card import FILE, card_text
from .license import UNSAID
from .measured import Measured

_MARK = re.compile(r"\n<!-- uavtwin card ([0-9a-f]{64}) -->\n\Z")
_LICENSE = re.compile(r'^license: "([A-Za-z0-9.-]+)"$', re.MULTILINE)
_LONGEST = 1_000_000
"""Bytes that are looked at; what is longer is none of ours."""


def write_card(folder: Path, claim: str, license: str = UNSAID) -> str:
    """Write the card of a model that was trained just now; returns its name.

    Args:
        folder: That `train` wrote.
        claim: What the model is, in one sentence.
        license: Of the model.
    """
    (folder / FILE).write_text(_signed(card_text(folder, claim, license)), "utf-8")
    return FILE


def complete_card(folder: Path, claim: str, measured: Measured, elsewhere: Path) -> Path:
    """Write the card of a model that was measured.

    A card that somebody has edited, or that cannot be replaced, stays as it is.

    Args:
        folder: Of the model.
        claim: What the model is, in one sentence.
        measured: What was found.
        elsewhere: Folder for the card where it does not go beside the model.

    Returns:
        The card, in one of both folders.
    """
    card, license = folder / FILE, UNSAID
    there = _text(card)
    if found := _LICENSE.search(there.partition("\n---")[0]):
        license = found[1]
    text = _signed(card_text(folder, claim, license, measured))
    if there and not _is_ours(there):
        card = elsewhere / FILE
    try:
        with output_file(card) as file:
            file.write_text(text, "utf-8")
    except TwinError:
        card = elsewhere / FILE
        card.write_text(text, "utf-8")
    return card


def _text(card: Path) -> str:
    """What stands there; "" where there is none."""
    if not card.is_file():
        return ""
    with card.open("rb") as file:
        return file.read(_LONGEST).decode("utf-8", "replace")


def _signed(text: str) -> str:
    """A card with the hash of it at its end."""
    return f"{text}\n<!-- uavtwin card {_hash(text)} -->\n"


def _is_ours(text: str) -> bool:
    """Whether a card is as it was written."""
    mark = _MARK.search(text)
    return mark is not None and _hash(text[: mark.start()]) == mark[1]


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
