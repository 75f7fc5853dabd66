"""The figures of the score as plain text."""

from typing import Any

_KINDS = {"single": "single", "pair": "pair", "nothing": "quiet", "outside": "outside"}


def table(figures: dict[str, Any]) -> str:
    """The figures as text, 95 % intervals in brackets."""
    lines = [f"{figures['cases']} cases", ""]
    lines.append(f"{'':<50} {'value':>7} {'95 %':>16} {'n':>6}  goal")
    lines += [
        f"{row['what']:<50} {_value(row):>7} {_interval(row):>16} {row['n']:>6}  "
        f"{row.get('goal', '')}".rstrip()
        for row in (*figures["goals"], *figures["more"])
    ]
    lines += _life(figures)
    for by, groups in figures["by"].items():
        lines += ["", f"{'right, by ' + by:<18}" + "".join(f"{k:>16}" for k in _KINDS.values())]
        lines[-1] += f"{'cannot tell':>16}"
        lines += [
            f"  {value:<16}" + "".join(f"{_of(group[k]):>16}" for k in (*_KINDS, "cannot_tell"))
            for value, group in groups.items()
        ]
    lines += ["", f"{'effect':<24} {'n':>4} {'recall':>16} {'precision':>16} {'cannot tell':>16}"]
    lines += [
        f"{name:<24} {e['n']:>4} "
        + " ".join(f"{_of(e[k]):>16}" for k in ("recall", "precision", "cannot_tell"))
        for name, e in figures["effects"].items()
    ]
    lines += ["", f"{'number':<42} {'n':>4} {'error':>8} {'covered':>10}  law"]
    lines += [
        f"{name:<42} {p['error']['n']:>4} {_value(p['error']):>8} {_of(p['coverage']):>10}  "
        + ("same" if p["same_law"] else "alike about hover")
        for name, p in figures["parameters"].items()
    ]
    lines += ["", "wrong answers: hidden -> said"]
    lines += [f"{c['n']:>4}  {c['hidden']} -> {c['said']}" for c in figures["confusions"]]
    return "\n".join(lines + _remarks(figures))


def _life(figures: dict[str, Any]) -> list[str]:
    """Cases as in life, and both halves side by side where there are two."""
    lines = []
    if figures["life"]:
        lines += ["", f"{'as in life':<50} {'value':>7} {'95 %':>16} {'n':>6}"]
        lines += [
            f"{row['what']:<50} {_value(row):>7} {_interval(row):>16} {row['n']:>6}"
            for row in figures["life"]
        ]
    halves = {h: {r["what"]: r for r in rows} for h, rows in figures["halves"].items()}
    first, second = halves.values()
    shared = [w for w in first if w in second and first[w]["n"] and second[w]["n"]]
    if shared:
        lines += ["", f"{'by half':<50}" + "".join(f"{h:>20}" for h in halves)]
        lines += [
            f"{what:<50}" + "".join(f"{_counted(rows[what]):>20}" for rows in halves.values())
            for what in shared
        ]
    return lines


def _counted(row: dict[str, Any]) -> str:
    return f"{_value(row)} (n {row['n']})"


def _remarks(figures: dict[str, Any]) -> list[str]:
    """What a reader must know before the figures are believed."""
    lines = [f"{e['case']} failed: {e['error']}" for e in figures["errors"]]
    if figures["missing"]:
        lines.append(
            f"{len(figures['missing'])} cases have no result, {figures['missing'][0]} first"
        )
    if len(figures["twin"]) > 1:
        states = ", ".join(f"{n} by {state}" for state, n in figures["twin"].items())
        lines.append(f"results of different states of twin/: {states}; see --again changed")
    return ["", *lines] if lines else []


def _value(row: dict[str, Any]) -> str:
    value = row["value"]
    return "-" if value is None else f"{value:.3g}" if value >= 10 else f"{value:.3f}"


def _interval(row: dict[str, Any]) -> str:
    return "" if row["ci95"] is None else "[{:.3g}, {:.3g}]".format(*row["ci95"])


def _of(row: dict[str, Any]) -> str:
    """A share as good ones of all."""
    return f"{row['value']:.2f} ({row['good']}/{row['n']})" if row["n"] else "-"
