"""The page: what was asked, what changes what is said, what changes nothing."""

from collections import Counter
from collections.abc import Iterable, Sequence
from operator import attrgetter

from benchmarks.hidden_effects.measures import Outcome
from twin.explain.setting_group import Value, numbers
from twin.explain.settings import DEFAULT

from .changes import SMALL, Change
from .watch import Noted

HEAD = """<!-- Written by docs/_generate/sensitivity.py; nothing here is written by hand. -->
# Sensitivity: every setting halved and doubled

What `explain` says about [hidden effects](hidden_effects.md) when one of its
[settings](../reference/settings.md) is halved or doubled and the others stay. A whole number stays
whole; a share or probability that would reach its bound goes halfway there instead (0.8 is doubled
to 0.9).

```sh
{command}
```

The command goes on where it was stopped. A case is run once with all {every} settings watched:
whether they are consulted, and whether any comparison comes out otherwise with one of them halved
or doubled, or its value goes where it cannot be followed (an index, a filter, a fit). A change that
passes without is one that cannot matter in that case. The others are asked for, at a whole search
each, unless `--watch` is given.

"""


def page(
    command: str,
    every: int,
    usual: Sequence[Outcome],
    changes: Sequence[Change],
    state: str,
    watched: Sequence[Noted] = (),
) -> str:
    """The whole document.

    Args:
        command: That makes it.
        every: How many settings there are.
        usual: Answers with the default settings.
        changes: Of each variant that was asked for.
        state: Of `twin/`.
        watched: What was noted in each case.
    """
    right = sum(o.right for o in usual)
    asked = {c.variant.setting.name for c in changes}
    lines = [
        HEAD.format(command=command, every=every) + "## What it covers",
        "",
        f"{len(asked) or every} of {every} settings, {len(usual)} cases: {_cases(usual)}. "
        f"With the default settings {right} of {len(usual)} are right. Where a case is far from a "
        f"decision no setting that is a little off will show: few cases show only the coarsest "
        f"changes, and nothing that is said here holds for cases that were not asked.",
        *(_asked(changes) if changes else []),
        *(_watched(watched) if watched else []),
        "",
        f"State of `twin/`: {state}. Settings have the names of that state; the "
        f"[changelog](../../CHANGELOG.md) says which have others now.",
    ]
    return "\n".join(lines) + "\n"


def _asked(changes: Sequence[Change]) -> list[str]:
    """What changes the answer, and what does not, of that which was asked for."""
    telling = sorted((c for c in changes if c.matters), key=lambda c: c.rank, reverse=True)
    head = (
        *("setting", "from", "to", "other verdict", "other names"),
        *("probability moves by up to", "right"),
    )
    silent = {c.variant.setting.name for c in changes} - {c.variant.setting.name for c in telling}
    return [
        *("", "## What changes what is said", ""),
        *(_table(head, map(_row, telling)) if telling else ["Nothing."]),
        *("", "## What changes nothing", ""),
        f"Neither halved nor doubled do these change a verdict, a name, or a probability by "
        f"{SMALL:g}: {_names(silent)}.",
    ]


def _watched(watched: Sequence[Noted]) -> list[str]:
    """What cannot matter in any case, what may, and what no case asks for."""
    consulted, may = (
        Counter(name for noted in watched for name in {c.rpartition(".")[0] for c in own(noted)})
        for own in (attrgetter("consulted"), attrgetter("may"))
    )
    free = {f"{n}` ({k})": k for n, k in consulted.items() if n not in may}
    some = {f"{n}` ({k} of {consulted[n]})": k for n, k in may.items()}
    unasked = {s.name for s in DEFAULT.every()} - consulted.keys()
    return [
        *("", "## What cannot matter", ""),
        f"Halved and doubled, no step of a search comes out otherwise in any of the {len(watched)} "
        f"cases; in brackets, how many consult the setting: {_names(free, '')}.",
        *("", "## What may matter", ""),
        f"In brackets, in how many of the cases that consult it: {_names(some, '')}.",
        *("", "## What no case asks for", ""),
        f"Nothing is known of {_names(unasked)}.",
    ]


def _names(names: Iterable[str], end: str = "`") -> str:
    return ", ".join(f"`{n}{end}" for n in sorted(names)) or "none"


def _cases(usual: Sequence[Outcome]) -> str:
    """Kinds of the cases, and what is hidden in them."""
    told = Counter(" and ".join(sorted(o.hidden)) or "nothing hidden" for o in usual)
    return ", ".join(name if n == 1 else f"{name} ({n})" for name, n in sorted(told.items()))


def _row(change: Change) -> Sequence[str]:
    variant, (now, before) = change.variant, change.right
    failed = f", {change.errors} failed" if change.errors else ""
    return (
        f"`{variant.setting.name}`",
        _value(variant.setting.value),
        _value(variant.value),
        f"{change.verdicts} of {change.cases}",
        f"{change.names} of {change.cases}",
        f"{change.probability:.2f}",
        f"{before} to {now}{failed}" if now != before else f"{now}{failed}",
    )


def _value(value: Value) -> str:
    return ", ".join(f"{x:.4g}" for x in numbers(value))


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    content = [f"| {' | '.join(line)} |" for line in (head, *lines)]
    return [content[0], "|" + "---|" * len(head), *content[1:]]
