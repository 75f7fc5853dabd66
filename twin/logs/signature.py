"""How the first bytes of a file tell what it is."""

import string
from dataclasses import dataclass
from typing import Protocol

HEAD = 4096
"""Bytes from the start of a file that a signature may look at."""
_TELLING = 4
"""Bytes of a longer signature after which a difference is damage, not another format."""
_LETTERS = string.ascii_letters.encode() + string.digits.encode()
_BEFORE_TEXT = b"\xef\xbb\xbf \t\"'"


class Signature(Protocol):
    """What files of one kind begin with."""

    def matches(self, head: bytes) -> bool:
        """Whether a file that begins so is of this kind; `head` has at most `HEAD` bytes."""
        ...

    def damage(self, head: bytes) -> str:
        """What is wrong where a file is nearly of this kind, "" where it is nothing like it."""
        ...

    def __str__(self) -> str:
        """The signature for a reader of the documentation."""
        ...


@dataclass(frozen=True, slots=True)
class Magic:
    """Fixed bytes at a fixed place.

    Attributes:
        content: The bytes.
        at: Where they begin.
    """

    content: bytes
    at: int = 0

    def matches(self, head: bytes) -> bool:
        """Whether the bytes stand there."""
        return head[self.at :].startswith(self.content)

    def damage(self, head: bytes) -> str:
        """Cut off within the signature, or its later bytes changed."""
        if self.at or self.matches(head):
            return ""
        if 1 < len(head) < len(self.content) and self.content.startswith(head):
            return f"cut off after {len(head)} bytes"
        if len(self.content) > _TELLING and head.startswith(self.content[:_TELLING]):
            return "its signature is damaged"
        return ""

    def __str__(self) -> str:
        letters = len(self.content) - len(self.content.lstrip(_LETTERS))
        text, rest = self.content[:letters].decode("ascii"), self.content[letters:].hex(" ")
        parts = (f"`{text}`" if text else "", f"bytes {rest}" if rest else "")
        return " ".join(p for p in parts if p) + (f" at byte {self.at}" if self.at else "")


@dataclass(frozen=True, slots=True)
class FirstWord:
    """Text that begins with a word, in any case, after a byte-order mark, blanks and quotes."""

    word: bytes

    def matches(self, head: bytes) -> bool:
        """Whether the text begins so."""
        return head.lstrip(_BEFORE_TEXT).lower().startswith(self.word)

    def damage(self, head: bytes) -> str:
        """Text has no signature that could be damaged."""
        return ""

    def __str__(self) -> str:
        return f"the word `{self.word.decode('ascii')}`"
