"""How Blackbox packs integers: by bytes of 7 bits, or several in a group behind a tag.

Each function takes bytes and a place and gives what stands there and the place behind it; it
raises IndexError at the end of the bytes and ValueError where no such thing can stand. Source:
Betaflight's documentation, "Blackbox logging internals", and encoding.c.
"""

_LONGEST_SHIFT = 28


def unsigned_vb(data: bytes, at: int) -> tuple[int, int]:
    """An integer of up to 32 bits, the lowest 7 first; all bytes but its last have the top bit."""
    byte = data[at]
    if byte < 128:
        return byte, at + 1
    value, shift = byte & 127, 7
    while True:
        at += 1
        byte = data[at]
        value |= (byte & 127) << shift
        if byte < 128:
            return value & 0xFFFFFFFF, at + 1
        shift += 7
        if shift > _LONGEST_SHIFT:
            raise ValueError("an integer of more than 5 bytes")


def signed_vb(data: bytes, at: int) -> tuple[int, int]:
    """The same with sign: 0, -1, 1, -2, 2 are stored as 0, 1, 2, 3, 4."""
    byte = data[at]
    if byte < 128:
        return (byte >> 1) ^ -(byte & 1), at + 1
    value, at = unsigned_vb(data, at)
    return (value >> 1) ^ -(value & 1), at


def neg_14bit(data: bytes, at: int) -> tuple[int, int]:
    """An integer of 14 bits with its sign turned."""
    value, at = unsigned_vb(data, at)
    return -sign_extended(value, 14), at


def sign_extended(value: int, bits: int) -> int:
    """The lowest bits of a number as one with sign."""
    half = 1 << (bits - 1)
    return ((value & (2 * half - 1)) ^ half) - half


def tag8_8svb(data: bytes, at: int, count: int) -> tuple[list[int], int]:
    """One to eight numbers; bit i of the tag says whether number i is there, else it is 0."""
    if count == 1:
        value, at = signed_vb(data, at)
        return [value], at
    tag = data[at]
    at += 1
    values = [0] * count
    for i in range(count):
        if tag >> i & 1:
            values[i], at = signed_vb(data, at)
    return values, at


def tag2_3s32(data: bytes, at: int) -> tuple[list[int], int]:
    """Three numbers, all of 2, 4 or 6 bits, or each of 1 to 4 bytes."""
    tag = data[at]
    size = tag >> 6
    if size == 0:
        return [sign_extended(tag >> shift, 2) for shift in (4, 2, 0)], at + 1
    if size == 1:
        rest = data[at + 1]
        return [
            sign_extended(tag, 4),
            sign_extended(rest >> 4, 4),
            sign_extended(rest, 4),
        ], at + 2
    if size == 2:
        return [
            sign_extended(tag, 6),
            sign_extended(data[at + 1], 6),
            sign_extended(data[at + 2], 6),
        ], at + 3
    values, at = [], at + 1
    for _ in range(3):
        width = (tag & 3) + 1
        values.append(_bytes(data, at, width))
        at, tag = at + width, tag >> 2
    return values, at


def _bytes(data: bytes, at: int, width: int) -> int:
    """A number with sign of some bytes, the lowest first."""
    if at + width > len(data):
        raise IndexError("the end")
    return int.from_bytes(data[at : at + width], "little", signed=True)


def tag8_4s16(data: bytes, at: int) -> tuple[list[int], int]:
    """Four numbers of 0, 4, 8 or 16 bits as two bits each of the tag say, the highest half-byte
    first; a half-byte that is left over is not used. Data version 2."""
    tag = data[at]
    at += 1
    if not tag:
        return [0, 0, 0, 0], at
    widths = [(0, 1, 2, 4)[tag >> shift & 3] for shift in (0, 2, 4, 6)]
    size = (sum(widths) + 1) // 2
    if at + size > len(data):
        raise IndexError("the end")
    bits, left = int.from_bytes(data[at : at + size], "big"), 8 * size
    values = []
    for width in widths:
        left -= 4 * width
        values.append(sign_extended(bits >> left, 4 * width) if width else 0)
    return values, at + size


def tag8_4s16_v1(data: bytes, at: int) -> tuple[list[int], int]:
    """The same in data version 1: two of 4 bits share a byte, the first the lower half, and then
    take the place of two numbers; one of 16 bits has its lowest byte first."""
    tag = data[at]
    at += 1
    values: list[int] = []
    while len(values) < 4:
        kind, tag = tag & 3, tag >> 2
        if kind == 0:
            values.append(0)
        elif kind == 1:
            byte, at, tag = data[at], at + 1, tag >> 2
            values += [sign_extended(byte, 4), sign_extended(byte >> 4, 4)]
        else:
            width = kind - 1
            values.append(_bytes(data, at, width))
            at += width
    return values[:4], at
