"""Time limit, stop request and progress of a search."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread
from typing import Any, NamedTuple, TypeVar

from ocp.solvers.worker import Worker
from tenscasadi.util.processes import on_interrupt
from tenscasadi.util.validate import Array, flag, positive_number

Result = TypeVar("Result")

STOPPED = "User_Requested_Stop"
TIME_UP = "Time_Limit_Reached"  # of the whole search, with all that comes before the solver
# permitted delay of results: 1 s after a stop request, the larger of 1 s and 10 % of a time limit
DELAY, RELATIVE_DELAY = 1.0, 0.1
# shares of it until which solvers may stop by themselves, and the last replay may end
STOPPING, REPLAYING = 0.3, 0.9


class Progress(NamedTuple):
    """Progress of a solver after one iteration.

    Attributes
    ----------
    iteration : int
        Number of the iteration, from 0.
    objective : float
        Sum of the costs, in their own units.
    infeasibility : float
        Largest violation of a constraint, scaled.

    Examples
    --------
    >>> import ocp
    >>> def watch(now: ocp.Progress) -> bool:
    ...     return now.infeasibility > 1e-3  # False stops the solver
    >>> watch(ocp.Progress(iteration=3, objective=1.5, infeasibility=0.1))
    True
    """

    iteration: int
    objective: float
    infeasibility: float


class Monitor:
    """Time limit, stop request and progress of a search.

    Parameters
    ----------
    time_limit : float, optional
        Wall time of the search [s]. By default there is no limit.
    show : callable, optional
        Function of a line of text, called at most twice a second. None: nothing is shown.
    watch : callable, optional
        Function of a `Progress`, called after each iteration. If it returns False, it requests a
        stop.

    Attributes
    ----------
    phase : str
        Current part of the search, for the progress.
    interrupted : bool
        Whether a stop was requested, as from the keyboard; see `stop`.
    """

    def __init__(
        self,
        time_limit: float | None = None,
        show: Callable[[str], object] | None = None,
        watch: Callable[[Progress], object] | None = None,
    ) -> None:
        self.began = time.perf_counter()
        self.deadline = math.inf if time_limit is None else self.began + time_limit
        self._delay = max(DELAY, RELATIVE_DELAY * (time_limit or 0.0))
        self.interrupted, self.phase = False, "final state"
        self._show, self._next_line = show, self.began + 2.0  # s
        self._watch, self._catches = watch, False
        self._thread = current_thread()
        self._worker: Worker | None = None
        self._latest: Progress | None = None
        self._whole = self

    def limit(self, time_limit: float | None) -> Monitor:
        """Build the monitor of a part of the search.

        The part has the time limit `time_limit` [s]; None is no limit. Its lines of progress have
        the phase of the whole search before its own, and the time of the whole search.
        """
        part = Monitor(time_limit, watch=self._watch)
        part._whole = self
        return part

    @property
    def elapsed(self) -> float:
        """Wall time since the start [s]."""
        return time.perf_counter() - self.began

    @property
    def left(self) -> float:
        """Remaining wall time [s], inf without a limit."""
        return self.deadline - time.perf_counter()

    @property
    def iterate(self) -> tuple[int, Array] | None:
        """Iteration number and best iterate of a function in a thread.

        None if there is no thread, or no iterate yet.
        """
        return None if self._worker is None else self._worker.iterate

    def status(self) -> str:
        """Return the reason why the search has to stop.

        It is "" if the search can go on.
        """
        if self.interrupted:
            return STOPPED
        return TIME_UP if self.left <= 0 else ""

    def run(
        self,
        work: Callable[[], Result],
        otherwise: Callable[[], Result],
        share: float = STOPPING,
    ) -> Result:
        """Run a function in a thread, and abandon it if it is late.

        `work` is the function; `otherwise` builds the result after it was abandoned, from
        `iterate`. The function is late if it has not returned after the time limit and the fraction
        `share` of the permitted delay. Callbacks of the user run in the calling thread.
        """

        def is_late() -> bool:
            self.show_line()
            return bool(self.status()) and -self.left > share * self._delay

        self._latest, self._worker = None, Worker(work)
        return self._worker.wait(is_late, otherwise)

    def ask(self, call: Callable[[], Result]) -> Result:
        """Call a function in the thread of the search.

        Raises Abandoned if the calling thread was abandoned.
        """
        if self._worker is None or current_thread() is self._thread:
            return call()
        return self._worker.ask(call)

    def follow(self, now: Progress, iterate: Array | None = None) -> str:
        """Report the progress of a solver, and return `status`.

        `now` is the progress after an iteration. `iterate` are the decision variables of the best
        iterate so far.
        """
        worker = self._worker
        if iterate is not None and worker is not None and worker.is_here:
            worker.iterate = now.iteration, iterate
        self._latest = now
        if current_thread() is self._thread:  # else that thread shows the lines while it waits
            self.show_line()
        watch = self._watch
        if watch is not None and self.ask(lambda: watch(now)) is False:
            self.stop()
        return self.status()

    def show_line(self) -> None:
        """Show a line of progress if the last one is old.

        Before the first iteration, it has the phase and the time only.
        """
        clock, whole = time.perf_counter(), self._whole
        if whole._show is None or clock < whole._next_line:
            return
        whole._next_line, now = clock + 0.5, self._latest
        line = "" if whole is self else f"{whole.phase}; "
        line += f"{self.phase}: "
        if now is not None:
            line += (
                f"iteration {now.iteration}, violation {now.infeasibility:.1e}, "
                f"objective {now.objective:.5g}, "
            )
        left = "" if math.isinf(whole.deadline) else f", {max(whole.left, 0.0):.0f} s left"
        whole._show(f"{line}{whole.elapsed:.0f} s{left}")

    @contextmanager
    def catching_interrupts(self) -> Iterator[None]:
        """Convert the first Ctrl-C into a stop request."""
        if self._catches:  # the search within a refinement
            yield
            return
        self._catches = True
        try:
            with on_interrupt(self.stop, then_raise=False):
                yield
        finally:
            self._catches = False

    def stop(self) -> None:
        """Request that the search stops."""
        self.interrupted, self._delay = True, DELAY
        self.deadline = min(self.deadline, time.perf_counter())


def build_monitor(time_limit: Any, progress: Any) -> Monitor:
    """Build the monitor of a search from the arguments of `ocp.solve`.

    `time_limit` [s] and `progress` are as there. Raises TypeError, ValueError.
    """
    watch = progress if callable(progress) else None
    if progress is not None and watch is None:
        flag("progress", progress)
    if time_limit is not None:
        positive_number("time_limit", time_limit)
    shown = sys.stderr.isatty() if progress is None else bool(progress)
    return Monitor(time_limit, write_line if shown else None, watch)


def write_line(line: str) -> None:
    """Write a line of progress in place of the last one."""
    sys.stderr.write(f"\r\033[K{line}")
    sys.stderr.flush()
