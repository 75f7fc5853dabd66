"""What a flight of an autopilot on the twin has been up to now."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class HilStatus:
    """A flight under an autopilot.

    Attributes:
        peer: Who flew, HOST:PORT; "": nobody connected.
        flight_s: Simulated time.
        wall_s: That it took, from the connection on.
        answers: HIL_ACTUATOR_CONTROLS that came.
        lockstep: Whether the autopilot waits for the simulator.
        armed: Whether motors may turn now.
        armed_s: Simulated time for which they might.
        position_n: True position, m, NED.
        clipped: Motor commands outside 0..1, set to its end.
        unknown: Motor commands of armed motors that were no number, taken for 0.
        link: Counts of messages, garbage, refused connections.
        ended: Why it ended; "": it goes on.
        fine: Whether it ended as was asked for.
    """

    peer: str = ""
    flight_s: float = 0.0
    wall_s: float = 0.0
    answers: int = 0
    lockstep: bool = False
    armed: bool = False
    armed_s: float = 0.0
    position_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clipped: int = 0
    unknown: int = 0
    link: Mapping[str, int] = field(default_factory=dict)
    ended: str = ""
    fine: bool = True

    def json(self) -> dict[str, Any]:
        """For a program."""
        return asdict(self)

    def line(self) -> str:
        """One line for a terminal."""
        if not self.peer:
            return "no autopilot has connected yet"
        north, east, down = self.position_n
        parts = [
            f"{self.flight_s:.1f} s, {self.flight_s / max(self.wall_s, 1e-9):.2f} of real time",
            f"{self.answers} answers{' in lockstep' if self.lockstep else ''}",
            "armed" if self.armed else "not armed",
            f"{north:.2f} m north, {east:.2f} m east, {-down:.2f} m up",
        ]
        if self.link.get("garbage") or self.link.get("wrong"):
            parts.append(f"{self.link['garbage']} bytes of garbage, {self.link['wrong']} wrong")
        return "; ".join(parts)
