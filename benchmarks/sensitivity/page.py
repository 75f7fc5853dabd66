"""The page: what was asked, what changes what is said, what changes nothing."""

from collections import Counter
from collections.abc import Iterable, Sequence

from benchmarks.hidden_effects.measures import Outcome
from twin.explain.setting_group import Value, numbers

from .changes import SMALL, Change

HEAD = """<!-- Written by docs/_generate/sensitivity.py; nothing here is written by hand. -->
# Sensitivity: every setting halved and doubled

What `explain` says about [hidden effects](hidden_effects.md) when one of its
[settings](../reference/settings.md) is halved or doubled and the others stay. A whole number stays
whole; a share or probability that would reach its bound goes halfway there instead (0.8 is doubled
to 0.9).

```sh
{command}
```

The command goes on where it was stopped; without `--only` it asks for all {every} settings, about
ten seconds of a core per case and value.

"""


def page(
    command: str, every: int, usual: Sequence[Outcome], changes: Sequence[Change], state: str
) -> str:
    """The whole document.

    Args:
        command: That makes it.
        every: How many settings there are.
        usual: Answers with the default settings.
        changes: Of each variant.
        state: Of `twin/`.
    """
    asked = {c.variant.setting.name for c in changes}
    lines = [
        HEAD.format(command=command, every=every) + "## What it covers",
        "",
        f"{len(asked)} of {every} settings, {len(changes)} values, {len(usual)} cases: "
        f"{_cases(usual)}. With the default settings "
        f"{sum(o.right for o in usual)} of {len(usual)} are right. Where a case is far from a "
        f"decision no setting that is a little off will show: few cases show only the coarsest "
        f"changes, and nothing that is said here holds for cases that were not asked.",
        "",
        "## What changes what is said",
        "",
    ]
    telling = sorted((c for c in changes if c.matters), key=lambda c: c.rank, reverse=True)
    head = (
        "setting",
        "from",
        "to",
        "other verdict",
        "other names",
        "probability moves by up to",
        "right",
    )
    lines += _table(head, map(_row, telling)) if telling else ["Nothing."]
    silent = sorted(asked - {c.variant.setting.name for c in telling})
    lines += [
        "",
        "## What changes nothing",
        "",
        f"Neither halved nor doubled do these change a verdict, a name, or a probability by "
        f"{SMALL:g}: {', '.join(f'`{n}`' for n in silent) or 'none'}.",
        "",
        f"State of `twin/`: {state}.",
    ]
    return "\n".join(lines) + "\n"


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
