"""Keeping and restoring the state of a whole system."""

from .bus import Bus
from .slave.slave import SavedState


class Rollback:
    """One kept state of all slaves and of the bus, overwritten by each `keep`."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self._states: dict[str, SavedState] = {}

    def keep(self) -> None:
        """Keep the present state.

        Raises:
            FmuError: A slave cannot save its state.
        """
        for name, s in self.bus.slaves.items():
            self._states[name] = s.save(self._states.get(name))
        self._values = self.bus.values.copy()

    def back(self) -> None:
        """Return to the kept state."""
        for name, s in self.bus.slaves.items():
            s.restore(self._states[name])
        self.bus.values[:] = self._values

    def free(self) -> None:
        """Forget it."""
        for name, state in self._states.items():
            self.bus.slaves[name].free(state)
        self._states.clear()
