"""The head of a model card: plain YAML, as Hugging Face reads it.

Written by hand, as it takes 20 lines: strings in quotes, so that no name of a file can be anything
else, and numbers to the last bit, in the form that YAML 1.1 and 1.2 read alike.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import Any


def yaml_head(content: Mapping[str, Any]) -> str:
    """Text of a head, its marks included.

    Args:
        content: Texts, numbers, truth values, None, and lists and mappings of them.
    """
    return "\n".join(["---", *_mapping(content), "---"])


def _mapping(content: Mapping[str, Any]) -> Iterator[str]:
    """Lines of a mapping."""
    for key, value in content.items():
        if isinstance(value, Mapping) and value:
            yield f"{key}:"
            yield from (f"  {line}" for line in _mapping(value))
        elif isinstance(value, Sequence) and not isinstance(value, str) and value:
            yield f"{key}:"
            for item in value:
                first, *more = _mapping(item) if isinstance(item, Mapping) else [_scalar(item)]
                yield f"- {first}"
                yield from (f"  {line}" for line in more)
        else:
            yield f"{key}: {_scalar(value)}"


def _scalar(value: Any) -> str:
    """A text, a number, or what is empty."""
    if isinstance(value, float):
        if not isfinite(value):
            return "null"
        mantissa, exponent, power = repr(value).partition("e")
        return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent}{power}"
    return "".join(
        c if c.isprintable() else f"\\U{ord(c):08x}" for c in json.dumps(value, ensure_ascii=False)
    )
