"""In which order a master visits and steps its slaves."""

from collections.abc import Iterable, Mapping, Set

from fmus.order import Loop, Visit, slave_of


def batches(
    order: Iterable[Visit], dependencies: Mapping[str, Set[str]]
) -> list[tuple[str, ...] | Loop]:
    """Successive slaves that do not depend on each other, in one batch."""
    sources_of: dict[str, set[str]] = {}
    for output, sources in dependencies.items():
        sources_of.setdefault(slave_of(output), set()).update(map(slave_of, sources))
    result: list[tuple[str, ...] | Loop] = []
    for visit in order:
        last = result[-1] if result else None
        if isinstance(visit, Loop):
            result.append(visit)
        elif isinstance(last, tuple) and visit not in last and not sources_of[visit] & {*last}:
            result[-1] = (*last, visit)
        else:
            result.append((visit,))
    return result


def stepping_order(order: Iterable[Visit], slaves: Iterable[str]) -> list[Visit]:
    """Every slave once, by its last visit, and every loop as soon as its last member has stepped.

    Slaves that are never visited, those without outputs, come last.
    """
    order = list(order)
    last = {
        s: i
        for i, v in enumerate(order)
        for s in ([v] if isinstance(v, str) else map(slave_of, v.outputs))
    }
    sequence = sorted(slaves, key=lambda s: last.get(s, len(order)))
    result: list[Visit] = list(sequence)
    for loop in (v for v in order if isinstance(v, Loop)):
        end = 1 + max(result.index(slave_of(o)) for o in loop.outputs)
        while end < len(result) and isinstance(result[end], Loop):
            end += 1  # loops with the same last member stay in their order
        result.insert(end, loop)
    return result
