"""Speed of a simulation relative to the wall clock."""

from __future__ import annotations

from collections import deque

_WINDOW = 1.0  # s, over which the speed is measured
_DELAY = 0.1  # s, which may be caught up; more is dropped


class Pace:
    """Counter of simulation ticks that are due by the wall clock.

    The caller gives times of any increasing clock [s]. A delay of more than a tenth of a second is
    dropped. The simulation is then slower than requested, which `message` reports.

    Parameters
    ----------
    tick : float
        Simulated time of a tick [s].
    speed : float
        Simulated seconds per second.

    Examples
    --------
    >>> from tenscasadi.viewer.live_mode.pace import Pace
    >>> pace = Pace(0.25)
    >>> pace.due(0.0), pace.due(0.25)
    (0, 1)
    >>> pace.done(1, 0.25)
    >>> pace.due(0.5)
    1
    """

    def __init__(self, tick: float, speed: float = 1.0) -> None:
        self.tick = tick
        self._speed = speed
        self._debt = 0.0  # ticks
        self._last: float | None = None
        self._log: deque[tuple[float, int]] = deque()

    @property
    def speed(self) -> float:
        """Requested speed, in simulated seconds per second."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._speed = value
        self.rest()

    def rest(self) -> None:
        """Restart the counter after a pause, with no ticks due."""
        self._debt, self._last = 0.0, None
        self._log.clear()

    def due(self, now: float) -> int:
        """Count the whole ticks that are due at a time `now` [s].

        A tick is the interval in which inputs are constant.
        """
        if self._last is None:
            self._last = now
            self._log.append((now, 0))
        self._debt += (now - self._last) * self._speed / self.tick
        self._debt = min(self._debt, max(1.0, _DELAY * self._speed / self.tick))
        self._last = now
        return int(self._debt + 1e-9)

    def done(self, ticks: int, now: float) -> None:
        """Record computed ticks, and the clock time `now` after them [s]."""
        self._debt -= ticks
        self._log.append((now, ticks))
        while len(self._log) > 2 and now - self._log[1][0] >= _WINDOW:
            self._log.popleft()

    def wait(self, now: float) -> float:
        """Compute the time until the next tick is due [s].

        `now` is the current time of the clock [s].
        """
        passed = 0.0 if self._last is None else now - self._last
        return max(0.0, (1.0 - self._debt) * self.tick / self._speed - passed)

    @property
    def measured(self) -> float:
        """Measured speed over the last second; NaN at the beginning."""
        if len(self._log) < 2 or (span := self._log[-1][0] - self._log[0][0]) < _WINDOW / 2:
            return float("nan")
        return sum(ticks for _, ticks in list(self._log)[1:]) * self.tick / span

    @property
    def message(self) -> str:
        """Report of a speed below the requested one, or ""."""
        measured = self.measured
        if not measured < 0.95 * self._speed:
            return ""
        return f"{measured:.2g} times real time: this machine is too slow for {self._speed:g}, try a larger step or another scheme"
