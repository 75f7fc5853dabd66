"""XML of other programs, read without entities, document types or a network."""

from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from ....errors import ModelError
from ... import Array

Element = Any
"""An element of lxml, which has no types."""
LARGEST_BYTES = 20_000_000


def read_xml(path: Path) -> Element:
    """Root of an XML file.

    Raises:
        ModelError: It cannot be read, is no XML, is too large or has a document type.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise ModelError(f"{path.name}: has more than {LARGEST_BYTES // 10**6} MB; too large.")
        parser = etree.XMLParser(
            resolve_entities=False,
            no_network=True,
            load_dtd=False,
            remove_comments=True,
            remove_pis=True,
        )
        tree = etree.fromstring(path.read_bytes(), parser).getroottree()
    except OSError as error:
        raise ModelError(f"{path.name}: cannot be read: {error}.") from error
    except etree.XMLSyntaxError as error:
        raise ModelError(f"{path.name}: not valid XML: {error}.") from error
    if tree.docinfo.doctype:
        raise ModelError(
            f"{path.name}: has a document type ({tree.docinfo.doctype[:60]}), which may hold "
            f"entities; take it out."
        )
    return tree.getroot()


def floats(file: str, what: str, text: str | None, count: int) -> Array:
    """So many finite numbers, separated by blanks.

    Raises:
        ModelError: They are something else; the text names the file, what they are, and the text.
    """
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise ModelError(f"{file}: {what} is {text!r}, not {count} number(s).")
    return values


def number(file: str, parent: Element, tag: str) -> float:
    """The number in a child element.

    Raises:
        ModelError: There is no such child, or it holds no number.
    """
    child = parent.find(tag)
    if child is None:
        raise ModelError(f"{file}: <{parent.tag}> has no <{tag}>.")
    return float(floats(file, f"<{tag}>", child.text, 1)[0])
