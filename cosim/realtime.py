"""Real time: simulated time does not run ahead of the clock."""

import time


class Pace:
    """Waits at communication points until the clock has come as far.

    Every deadline is counted from the first one, so waiting too long once delays nothing after
    it.

    Attributes:
        lateness_s: Longest time by which a communication point was reached too late.
    """

    def __init__(self, factor: float, start_time_s: float) -> None:
        self._factor, self._start_time_s = factor, start_time_s
        self._begin = time.perf_counter()
        self.lateness_s = 0.0

    def wait(self, time_s: float) -> None:
        """Return when the clock shows a simulated time, at once when it is late."""
        due = self._begin + (time_s - self._start_time_s) / self._factor
        ahead_s = due - time.perf_counter()
        if ahead_s > 0:
            time.sleep(ahead_s)
        else:
            self.lateness_s = max(self.lateness_s, -ahead_s)
