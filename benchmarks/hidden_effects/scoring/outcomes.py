"""Cases of which both are known: what was hidden and what was said."""

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..halves import half_of

FAR = 2.0
"""A number of the file so many of its deviations off is one that may be named."""


@dataclass(frozen=True)
class Outcome:
    """One case: the truth and what was said about it."""

    truth: dict[str, Any]
    said: dict[str, Any]

    @property
    def kind(self) -> str:
        """single, pair, triple, outside, nothing, many, uncertain or since."""
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
        """Effects that the program is sure of, the surest first; none unless the verdict is
        "named"."""
        if self.verdict != "named":
            return []
        unsure = self.said.get("undecided") or ()
        effects = sorted(self.said["effects"], key=lambda e: -e["probability"])
        return [e["name"] for e in effects if e["name"] not in unsure]

    @property
    def resembled(self) -> set[str]:
        """Effects that something acts like."""
        return {r["name"] for r in self.said.get("acts_like") or ()}

    @property
    def half(self) -> str:
        """tune or score."""
        happened = self.truth.get("class")
        names = self.hidden if happened is None else {happened} - {"none"}
        return half_of(self.truth["plant"], self.kind, names, self.truth.get("seed", 0))

    @property
    def lives(self) -> bool:
        """Whether it has what real aircraft have, and is no case of today."""
        return bool(self.truth.get("life"))

    @property
    def excused(self) -> set[str]:
        """Names that are neither right nor wrong: what puts a number of the file right that is far
        off, or days whose mean happens to be; and a late clock is never early, so that its days
        have a mean."""
        late = {"position_delay"} if self.truth.get("days") else set()
        late |= {e for e, z in self.truth.get("day_means", {}).items() if z > FAR}
        far = {e["effect"] for e in self.truth.get("file", ()) if abs(e["z"]) > FAR}
        return (late | far) - self.hidden

    def indistinguishable_from(self, name: str) -> set[str]:
        """Effects that the program says could stand for a name as well, the name with it; of one
        rotor or clock, "effect:part", the effect counts."""
        of_name = [e.get("one_of") or [] for e in self.said["effects"] if e["name"] == name]
        return {name} | {n.partition(":")[0] for names in of_name for n in names}

    @property
    def right(self) -> bool:
        """The first name of a single effect, all of several, or the right other verdict."""
        match self.kind:
            case "nothing" | "uncertain":
                return self.verdict == "nothing"
            case "outside":
                return self.verdict == "unnamed"
            case "pair" | "triple" | "many":
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
