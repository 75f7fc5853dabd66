"""The licence of a model, as Hugging Face names it."""

import re

from twin.errors import TwinError

UNSAID = "unknown"
"""Hugging Face's word for a licence that nobody has named."""
_LICENSE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]{0,60}")


def check_license(name: str) -> str:
    """The name of a licence, if it can be one.

    Raises:
        TwinError: It cannot.
    """
    if not _LICENSE.fullmatch(name):
        raise TwinError(
            f"license {name!r}: give an identifier of letters, digits, dots and hyphens, e.g. "
            "cc-by-4.0 or other."
        )
    return name
