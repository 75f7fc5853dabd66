"""Values as C source: all text and numbers of generated C pass through here.

What is written is a literal or a checked identifier, so no value can end it and go on as code.
"""

import math
from collections.abc import Iterable

from twin.errors import FmuError

from .names import shown

_PLAIN = frozenset(map(chr, range(0x20, 0x7F))) - frozenset('"\\?')
"""Stand for themselves in a string; `?` not, since two of them begin a trigraph of C99."""


def c_string(text: str) -> str:
    """A string literal of the text as UTF-8.

    Raises:
        FmuError: It holds the character 0, which ends a string of C, or half a character.
    """
    try:
        encoded = text.encode()
    except UnicodeEncodeError:
        encoded = b"\0"
    if 0 in encoded:
        raise FmuError(f"{shown(text)} cannot be a string of C: take the character 0 out of it.")
    # An octal escape has three digits at most, so what follows it is never taken for a part of it.
    plain = (chr(b) if chr(b) in _PLAIN else f"\\{b:03o}" for b in encoded)
    return f'"{"".join(plain)}"'


def c_number(value: float) -> str:
    """A whole number, or a double that reads back as the same.

    Raises:
        FmuError: It is not finite, or no number at all.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise FmuError(f"{shown(value)} cannot be a constant of C: give a finite number.")
    return int.__repr__(value) if isinstance(value, int) else float.__repr__(value)


def c_list(values: Iterable[float]) -> str:
    """Initialiser of an array of numbers.

    Raises:
        FmuError: One of them is not finite.
    """
    return f"{{{', '.join(map(c_number, values))}}}"
