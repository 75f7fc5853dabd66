"""Shares and medians with how sure they are."""

import math
from collections.abc import Callable, Iterable, Sequence
from statistics import median
from typing import Any

_Z95 = 1.959964


def rate(items: Sequence[Any], good: Callable[[Any], bool]) -> dict[str, Any]:
    """Share of the good ones, null where there are none."""
    return share(sum(map(good, items)), len(items))


def share(good: int, n: int) -> dict[str, Any]:
    """Share with its 95 % interval."""
    return {"value": good / n if n else None, "n": n, "good": good, "ci95": wilson(good, n)}


def wilson(good: int, n: int) -> list[float] | None:
    """95 % interval of a share. Source: Wilson, J. Am. Stat. Assoc. 22 (1927)."""
    if not n:
        return None
    p, z2 = good / n, _Z95**2 / n
    middle = (p + z2 / 2) / (1 + z2)
    half = _Z95 / (1 + z2) * math.sqrt(p * (1 - p) / n + z2 / (4 * n))
    low = 0.0 if good == 0 else middle - half
    return [low, 1.0 if good == n else middle + half]


def middle(values: Iterable[float]) -> dict[str, Any]:
    """Median with a 95 % interval by order statistics, null where there are too few for one."""
    finite = sorted(v for v in values if math.isfinite(v))
    n = len(finite)
    return {"value": median(finite) if finite else None, "n": n, "ci95": _around_median(finite)}


def _around_median(ordered: Sequence[float]) -> list[float] | None:
    """The narrowest pair of values, as far from either end, that holds the median in 95 %."""
    n, below, found = len(ordered), 0.0, None
    for k in range((n + 1) // 2):
        below += math.comb(n, k) / 2**n  # the median lies below value k
        if below > 0.025:
            break
        found = [ordered[k], ordered[n - 1 - k]]
    return found
