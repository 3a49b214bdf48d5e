"""How fast a motion goes by the clock on the wall, and how far it falls behind."""

from __future__ import annotations

from collections import deque

_WINDOW = 1.0  # s over which speed is measured
_LATE = 0.1  # s that may be caught up; more is let go
_AS_ASKED = 0.95  # of the speed that was asked for: less is said


class Pace:
    """Tells how many ticks are due, and measures how many are done.

    Time is given by the caller, s by any clock that increases. What cannot be caught up in a tenth
    of a second is let go: the motion is then slower than was asked for, and `words` says so.

    Parameters
    ----------
    tick : float
        Time of the motion in a tick, s.
    speed : float
        Time of the motion in a second.

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
        """Time of the motion in a second, as asked for."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._speed = value
        self.rest()

    def rest(self) -> None:
        """Start anew, as after a pause: nothing is due."""
        self._debt, self._last = 0.0, None
        self._log.clear()

    def due(self, now: float) -> int:
        """Return how many whole ticks are due.

        Parameters
        ----------
        now : float
            The time, s.

        Returns
        -------
        int
            Ticks to compute now.
        """
        if self._last is None:
            self._last = now
            self._log.append((now, 0))
        self._debt += (now - self._last) * self._speed / self.tick
        self._debt = min(self._debt, max(1.0, _LATE * self._speed / self.tick))
        self._last = now
        return int(self._debt + 1e-9)

    def done(self, ticks: int, now: float) -> None:
        """Count ticks that were computed.

        Parameters
        ----------
        ticks : int
            How many.
        now : float
            The time after them, s.
        """
        self._debt -= ticks
        self._log.append((now, ticks))
        while len(self._log) > 2 and now - self._log[1][0] >= _WINDOW:
            self._log.popleft()

    def wait(self, now: float) -> float:
        """Return the time until the next tick is due, s.

        Parameters
        ----------
        now : float
            The time, s.

        Returns
        -------
        float
            The wait, not below 0.
        """
        passed = 0.0 if self._last is None else now - self._last
        return max(0.0, (1.0 - self._debt) * self.tick / self._speed - passed)

    @property
    def measured(self) -> float:
        """Time of the motion in a second, as measured over the last one; NaN before half of it has passed."""
        if len(self._log) < 2 or (span := self._log[-1][0] - self._log[0][0]) < _WINDOW / 2:
            return float("nan")
        return sum(ticks for _, ticks in list(self._log)[1:]) * self.tick / span

    @property
    def words(self) -> str:
        """Words on the speed: "" where it is as asked for."""
        measured = self.measured
        if not measured < _AS_ASKED * self._speed:
            return ""
        return f"{measured:.2g} times real time: this machine is too slow for {self._speed:g}, try a larger step or another scheme"
