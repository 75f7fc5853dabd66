"""Reading what the definition of a frame of a Blackbox log lists, field after field."""

from collections.abc import Callable

from .encodings import (
    neg_14bit,
    signed_vb,
    tag2_3s32,
    tag8_4s16,
    tag8_4s16_v1,
    tag8_8svb,
    unsigned_vb,
)
from .header import (
    INCREMENT,
    NEG_14BIT,
    NULL,
    SIGNED_VB,
    TAG2_3S32,
    TAG8_4S16,
    TAG8_8SVB,
    UNSIGNED_VB,
    Fields,
)

_GROUPS = {TAG2_3S32: 3, TAG8_4S16: 4}

Read = Callable[[bytes, int], tuple[list[int], int]]
"""Values of a frame whose fields begin at a place in the data, and where they end. IndexError or
ValueError: the data end, or are none of these."""


def reader(fields: Fields, version: int) -> Read:
    """How to read what a frame lists, before anything predicted is added.

    Args:
        fields: Definition of the frame.
        version: Of the data, 1 or 2.

    Raises:
        ValueError: A group of fields is not whole.
    """
    four = tag8_4s16 if version > 1 else tag8_4s16_v1
    single = {SIGNED_VB: signed_vb, UNSIGNED_VB: unsigned_vb, NEG_14BIT: neg_14bit}
    steps: list[tuple[int, int]] = []
    at = 0
    while at < len(fields.names):
        kind = NULL if fields.predictors[at] == INCREMENT else fields.encodings[at]
        count = _GROUPS.get(kind, 1)
        if kind == TAG8_8SVB:
            while count < 8 and fields.encodings[at + count : at + count + 1] == (kind,):
                count += 1
        if fields.encodings[at : at + count] != (kind,) * count and kind != NULL:
            raise ValueError(f"fewer than {count} fields in a group from {fields.names[at]}")
        steps.append((kind, count))
        at += count

    def read(data: bytes, at: int) -> tuple[list[int], int]:
        """See `Read`."""
        values: list[int] = []
        for kind, count in steps:
            if kind in single:
                value, at = single[kind](data, at)
                values.append(value)
            elif kind == TAG8_8SVB:
                several, at = tag8_8svb(data, at, count)
                values += several
            elif kind == TAG2_3S32:
                several, at = tag2_3s32(data, at)
                values += several
            elif kind == TAG8_4S16:
                several, at = four(data, at)
                values += several
            else:
                values.append(0)
        return values, at

    return read
