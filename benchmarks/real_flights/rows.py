"""The tables of all rotations as rows of JSON, and the short page that is made of these rows."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import sqrt
from pathlib import Path
from typing import Any

from .details import RETURNED, figure, table

HEAD = Path(__file__).with_name("protocol.md").read_text("utf-8")
LABELLED = Path(__file__).parents[2] / "docs" / "results" / "labelled_flights.md"
"""Flights of which it is known what was done to the aircraft."""
BALANCES = ("acc_", "gyro_rate_")
"""Channels of force and moment, which the page shows; the others are in the file of rows."""
OVERVIEW = "numbers that pass"
"""Key of the rows of the overview alone."""
PLACE = "scenario", "section", "part"
"""Keys of a row that say where it belongs."""
Row = Mapping[str, Any]


def rows(details: str) -> Iterator[Row]:
    """Rows of all tables and all remarks, in order.

    Args:
        details: Markdown with a heading of level 2 per scenario and of level 3 per section.

    Yields:
        `scenario`, `section` and, in a table, its first cells by their heads; else `remark`.
    """
    scenario = section = part = ""
    head: list[str] = []
    for line in details.splitlines():
        if line.startswith("## "):
            scenario, section, part = line[3:], "", ""
        elif line.startswith("### "):
            section, part = line[4:], ""
        elif line.startswith("|"):
            cells = [c.replace("&#124;", "|").replace("`", "") for c in line[2:-2].split(" | ")]
            if head and not line.startswith("|---"):
                place = {"scenario": scenario, "section": section, "part": part}
                yield {k: v for k, v in place.items() if v} | dict(zip(head, cells, strict=True))
            head = head or cells
        elif line.endswith(":") and len(line) < 20:
            part = line[:-1]
        elif line:
            place = {"scenario": scenario, "section": section}
            yield {k: v for k, v in place.items() if v} | {"remark": line.removeprefix("- ")}
        if not line.startswith("|"):
            head = []


def write_rows(path: Path, found: Iterable[Row]) -> None:
    """A row a line."""
    lines = [json.dumps(row, ensure_ascii=False) + "\n" for row in found]
    path.write_text("".join(lines), "utf-8")


def renewed(stored: Sequence[Row], found: Sequence[Row], state: str) -> list[Row]:
    """Stored rows with those of some scenarios measured again, each with a remark that says so.

    Args:
        stored: As `write_rows` wrote them, facts first.
        found: Rows of these scenarios.
        state: When and by what they were measured.
    """
    facts, *every = stored
    titles = list(dict.fromkeys(r["scenario"] for r in found if "scenario" in r))
    again = {**facts.get("again", {}), **dict.fromkeys(titles, state)}
    heads = [r for r in found if OVERVIEW in r]
    rest = [r for r in found if OVERVIEW not in r]
    made: list[Row] = [{**facts, "again": again}]
    for row in every:
        own = row.get("scenario") in titles
        if not own:
            made.append(row)
        elif OVERVIEW in row:
            made += [r for r in heads if r["scenario"] == row["scenario"]]
        else:
            made += [r for r in rest if r["scenario"] == row["scenario"]]
            rest = [r for r in rest if r["scenario"] != row["scenario"]]
    return made


def read_rows(path: Path) -> list[Row]:
    """What `write_rows` has written."""
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def short_page(found: Sequence[Row], data: str) -> str:
    """The page: labelled flights, overview, numbers that agree, residuals of force and moment.

    Args:
        found: Rows, the first of them with `measured`, `note` and `state`, and in `again` when and
            by what scenarios were measured after that, by title.
        data: Name of the file of the rows, beside the page.
    """
    facts, *every = found
    again = facts.get("again", {})
    titles = {s: [t for t, own in again.items() if own == s] for s in again.values()}
    remarks = [facts["note"], *(f"{'; '.join(t)}: {s}" for s, t in titles.items())]
    facts = {**facts, "note": " ".join(filter(None, remarks))}
    parts = [HEAD.format(labelled=labelled(), data=data, **facts), *_overview(every)]
    parts += [
        *_returned(every),
        *_agreeing(every),
        *_wanted(every),
        *_gaps(every),
        "",
        facts["state"],
    ]
    return "\n".join(parts) + "\n"


def labelled() -> str:
    """What is said of labelled flights, with the trivial rule: the first table of their page."""
    lines = LABELLED.read_text("utf-8").splitlines()
    is_row = [line.startswith("|") for line in lines]
    first = is_row.index(True)
    return "\n".join(lines[first : is_row.index(False, first)])


def _overview(every: Sequence[Row]) -> list[str]:
    """All scenarios in a table."""
    shown = {
        "scenario": "scenario",
        "verdicts": "verdicts",
        "in every rotation": "in every rotation",
        "nothing speaks against": "nothing against it",
        "something acts like": "acts like",
        "numbers that pass": "numbers that agree",
    }
    lines = [[row[h] for h in shown] for row in every if OVERVIEW in row]
    first = {
        row["scenario"]: row["remark"]
        for row in reversed(every)
        if "section" not in row and "remark" in row
    }
    about = [f"- **{scenario}**: {text}" for scenario, text in reversed(first.items())]
    return ["", "## Overview", "", *about, "", *table(tuple(shown.values()), lines)]


def _returned(every: Sequence[Row]) -> list[str]:
    """Rotation by rotation what a scenario with a goal asks for."""
    own = [r for r in every if r.get("section") == RETURNED]
    text = [r["remark"] for r in own if "remark" in r]
    lines = [{k: v for k, v in r.items() if k not in PLACE} for r in own if "remark" not in r]
    if not lines:
        return []
    shown = table(list(lines[0]), (list(line.values()) for line in lines))
    return ["", f"## {own[0]['scenario']}: rotations", "", *text, "", *shown]


def _agreeing(every: Sequence[Row]) -> list[str]:
    """Numbers on which rotations agree, without those that are mostly their prior."""
    lines = []
    for row in every:
        if row.get("passes") != "yes" or row["mostly prior"] != "no":
            continue
        cells = [v for k, v in row.items() if k.startswith("without ") and v != "-"]
        values = sorted(float(c.split()[0].rstrip("*")) for c in cells)
        span = "…".join(dict.fromkeys(figure(v) for v in (values[0], values[-1])))
        number = f"`{row['number']}`, {row['unit']}"
        lines.append((row["scenario"], number, span, str(len(cells))))
    head = ("scenario", "number, unit", "values", "rotations")
    return ["", "## Numbers that agree", "", *table(head, _once(lines))]


def _wanted(every: Sequence[Row]) -> list[str]:
    """How near the numbers are that were made wrong on purpose."""
    said = [r for r in every if " was to be " in r.get("remark", "")]
    if not said:
        return []
    lines = [f"- {r['scenario']}: {r['remark']}" for r in said]
    return ["", "## Numbers made wrong on purpose", "", *lines]


def _gaps(every: Sequence[Row]) -> list[str]:
    """Rms of the held-out flights of a scenario together, by channel of force and moment."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in every:
        if "effects take" in row and row["channel"].startswith(BALANCES):
            groups.setdefault((row["scenario"], row["channel"]), []).append(row)
    lines = []
    for (scenario, channel), own in groups.items():
        left = [_pooled(own, c) for c in ("none", "effects", "fit mean", "floor")]
        ends = [_ends(row["effects take"]) for row in own]
        counts = (sum(low > 0 for low, _ in ends), sum(high < 0 for _, high in ends))
        lines.append((scenario, f"`{channel}`", *left, *map(str, counts)))
    head = (
        *("scenario", "channel, m/s² or rad/s²", "none", "effects", "fit mean", "floor"),
        *("smaller", "larger"),
    )
    return ["", "## Residuals of held-out flights", "", *table(head, _once(lines))]


def _pooled(own: Sequence[Row], column: str) -> str:
    """Rms over all samples of some flights."""
    known = [(float(row["n"]), float(row[column])) for row in own if row[column] != "-"]
    if len(known) < len(own):
        return "-"
    return figure(sqrt(sum(n * v * v for n, v in known) / sum(n for n, _ in known)))


def _ends(interval: str) -> tuple[float, float]:
    """Ends of "6 to 27 %"; 0 and 0 where there is no interval."""
    if interval == "-":
        return 0.0, 0.0
    low, _, high, _ = interval.split()
    return float(low), float(high)


def _once(lines: Iterable[Sequence[str]]) -> Iterator[Sequence[str]]:
    """Lines whose first cell is empty where it repeats that of the line before."""
    last = ""
    for first, *others in lines:
        yield ("" if first == last else first, *others)
        last = first
