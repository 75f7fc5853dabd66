"""What ArduPilot says of its flight."""

from .told import from_ardupilot_autopilot

__all__ = ["from_ardupilot_autopilot"]
