"""The licence of a model, as Hugging Face names it."""

import re
from pathlib import Path

import yaml

from twin.errors import TwinError

UNSAID = "unknown"
"""Hugging Face's word for a licence that nobody has named."""
_LICENSE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]{0,60}")
_HEAD = re.compile(r"---\n(.*?)\n---\n", re.DOTALL)


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
    """The licence that the head of a card names; `unknown` where it names none.

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
