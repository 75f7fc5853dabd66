"""Cases of which both are known: what was hidden and what was said."""

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Outcome:
    """One case: the truth and what was said about it."""

    truth: dict[str, Any]
    said: dict[str, Any]

    @property
    def kind(self) -> str:
        """single, pair, triple, outside or nothing."""
        return str(self.truth["kind"])

    @property
    def hidden(self) -> set[str]:
        """Names of what was hidden."""
        return {e["name"] for e in self.truth["effects"]}

    @property
    def verdict(self) -> str:
        """What the program decided; "error" where it gave no answer."""
        return str(self.said["verdict"])

    @property
    def named(self) -> list[str]:
        """Effects that the program added, the surest first; none unless the verdict is "named"."""
        if self.verdict != "named":
            return []
        effects = sorted(self.said["effects"], key=lambda e: -e["probability"])
        return [str(e["name"]) for e in effects]

    @property
    def right(self) -> bool:
        """The first name of a single effect, all of several, or the right other verdict."""
        match self.kind:
            case "nothing":
                return self.verdict == "nothing"
            case "outside":
                return self.verdict == "unnamed"
            case "pair" | "triple":
                return self.hidden <= set(self.named)
            case _:
                return self.named[:1] == [*self.hidden]

    @property
    def among_candidates(self) -> bool:
        """Whether everything hidden is among the effects listed or their rivals."""
        listed = self.said["effects"]
        rivals = {r["name"] for e in listed for r in e.get("rivals", [])}
        return self.hidden <= rivals | {e["name"] for e in listed}


def read_outcomes(
    results: Path, truth: Path, ids: Collection[str] | None = None
) -> tuple[list[Outcome], list[str]]:
    """Every case with a result, and the identifiers of those without one; default: all cases."""
    outcomes, missing = [], []
    for file in sorted(truth.glob("*.json")):
        if ids is not None and file.stem not in ids:
            continue
        said = results / file.name
        if said.is_file():
            outcomes.append(Outcome(json.loads(file.read_text()), json.loads(said.read_text())))
        else:
            missing.append(file.stem)
    return outcomes, missing
