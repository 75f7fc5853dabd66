"""Write the tables of the documentation from the definitions in code: `python docs/tables.py`.

Each document holds a pair of markers; what stands between them is replaced. `--check` changes
nothing and exits 1 if a table is out of date.
"""

import sys
from pathlib import Path

from twin.flightlog.columns import COLUMNS
from twin.vehicle_fields import FIELDS

HERE = Path(__file__).parent
BEGIN, END = "<!-- table: do not edit, run docs/tables.py -->", "<!-- end of table -->"


def flight_table() -> str:
    """Columns of the flight table."""
    rows = [f"| `{c.name}` | {c.unit or '-'} | {c.description} |" for c in COLUMNS]
    return "\n".join(["| column | unit | meaning |", "|---|---|---|", *rows])


def vehicle() -> str:
    """Keys of the vehicle file, a table per section."""
    lines: list[str] = []
    section = ""
    for key, field in FIELDS.items():
        if key.split(".")[0] != section:
            section = key.split(".")[0]
            lines += [
                "",
                f"### [{section}]",
                "",
                "| key | unit | needed | meaning |",
                "|---|---|---|---|",
            ]
        unit = field.unit.removeprefix("poly:") or "-"
        sign = {True: "; > 0", False: "; >= 0", None: ""}[field.positive]
        needed = "yes" if field.required else "no"
        lines.append(f"| `{key.split('.')[1]}` | {unit}{sign} | {needed} | {field.meaning} |")
    return "\n".join(lines[1:])


DOCUMENTS = {"flight_table.md": flight_table, "vehicle.md": vehicle}


def main(check: bool) -> int:
    """Bring all tables up to date; how many were not."""
    stale = 0
    for name, table in DOCUMENTS.items():
        path = HERE / name
        text = path.read_text("utf-8")
        head, rest = text.split(BEGIN)
        _, tail = rest.split(END)
        wanted = f"{head}{BEGIN}\n{table()}\n{END}{tail}"
        if wanted != text:
            stale += 1
            print(f"{name} is out of date")
            if not check:
                path.write_text(wanted, "utf-8")
    return stale


if __name__ == "__main__":
    sys.exit(1 if main("--check" in sys.argv) and "--check" in sys.argv else 0)
