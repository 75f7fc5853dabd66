"""Divisions and square roots of a kernel two by two.

A processor starts a division every five cycles and a root every nine, be it of one number or of two
side by side. A controller has so many of them that it waits for little else.
"""

from collections.abc import Sequence

import casadi as ca

from .operations import Operation

CYCLES = {ca.OP_DIV: 13, ca.OP_SQRT: 21, ca.OP_INPUT: 0, ca.OP_CONST: 0}
"""About how long an operation takes; others take `USUAL`."""
USUAL = 3
APART = 12
"""Cycles by which two that go together may be ready one after the other. As this is less than what
either takes, neither waits for the other, nor do any two pairs for each other."""


def paired(steps: Sequence[Operation]) -> dict[int, int]:
    """Partner of each division and each root that has one.

    Args:
        steps: Of one function; see `operations`.
    """
    done: list[int] = []  # when each is, if all begin as soon as they can
    for step in steps:
        begins = max((done[a] for a in step.arguments), default=0)
        done.append(begins + CYCLES.get(step.code, USUAL))
    partner: dict[int, int] = {}
    for code in (ca.OP_DIV, ca.OP_SQRT):
        left = sorted((k for k, s in enumerate(steps) if s.code == code), key=done.__getitem__)
        while len(left) > 1:
            one, other, *rest = left
            together = done[other] - done[one] <= APART
            if together:
                partner |= {one: other, other: one}
            left = rest if together else left[1:]
    return partner
