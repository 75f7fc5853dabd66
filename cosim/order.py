"""In which order the outputs of connected slaves become right, and which form algebraic loops."""

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True, slots=True)
class Loop:
    """Outputs, as "slave.output", that directly depend on themselves by way of each other."""

    outputs: tuple[str, ...]


Visit = str | Loop
"""A slave whose inputs are to be set and outputs read, or a loop that is to be solved."""


def visits(felt: Mapping[str, Set[str]]) -> list[Visit]:
    """An order of visits after which every output is right.

    A slave comes twice where some of its outputs are needed before its inputs are known: an
    airframe gives its position to a controller whose command enters its acceleration.

    Args:
        felt: Output -> the outputs that it directly depends on, through connected inputs. Outputs
            that are no keys are known beforehand.
    """
    order: list[Visit] = []
    remaining: dict[str, list[str]] = {}
    for output in felt:
        remaining.setdefault(slave_of(output), []).append(output)
    done: set[str] = set().union(*felt.values()) - felt.keys()
    while remaining:
        ready = {s: [o for o in outputs if felt[o] <= done] for s, outputs in remaining.items()}
        whole = [s for s, outputs in ready.items() if len(outputs) == len(remaining[s])]
        some = whole or [s for s, outputs in ready.items() if outputs]
        if some:
            order.append(some[0])
            done.update(ready[some[0]])
        else:
            loop = _first_loop([o for outputs in remaining.values() for o in outputs], felt, done)
            order.append(loop)
            done.update(loop.outputs)
        left = {s: [o for o in outputs if o not in done] for s, outputs in remaining.items()}
        remaining = {s: outputs for s, outputs in left.items() if outputs}
    return order


def _first_loop(outputs: list[str], felt: Mapping[str, Set[str]], done: Set[str]) -> Loop:
    """A strongly connected component that waits for nothing but itself."""
    index = {o: i for i, o in enumerate(outputs)}
    edges = [(index[source], index[o]) for o in outputs for source in felt[o] - done]
    ones, (rows, columns) = np.ones(len(edges)), np.transpose(edges)
    graph = csr_array((ones, (rows, columns)), shape=(len(outputs), len(outputs)))
    count, label = connected_components(graph, directed=True, connection="strong")
    for k in range(count):
        members = tuple(o for o in outputs if label[index[o]] == k)
        if all(felt[o] <= done | set(members) for o in members):
            return Loop(members)
    raise AssertionError("a finite graph has a component without predecessors")


def slave_of(name: str) -> str:
    """Slave of "slave.variable"."""
    return name.partition(".")[0]


def batches(order: Iterable[Visit], felt: Mapping[str, Set[str]]) -> list[tuple[str, ...] | Loop]:
    """Successive slaves that do not feel each other, put together."""
    feels: dict[str, set[str]] = {}
    for output, sources in felt.items():
        feels.setdefault(slave_of(output), set()).update(map(slave_of, sources))
    result: list[tuple[str, ...] | Loop] = []
    for visit in order:
        last = result[-1] if result else None
        if isinstance(visit, Loop):
            result.append(visit)
        elif isinstance(last, tuple) and visit not in last and not feels[visit] & {*last}:
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
