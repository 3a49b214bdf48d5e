"""The best iterate of a solver that may be watched, stopped or interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.util.interrupts import on_interrupt
from tenscasadi.util.validate import Array

STOPPED = "User_Requested_Stop"
NEAR = 1e-6  # violation, scaled, below which iterates are judged by their objective


class Progress(NamedTuple):
    """One iteration: its number, the objective (costs in their own units) and the largest violated constraint, scaled."""

    iteration: int
    objective: float
    infeasibility: float


Watcher = Callable[[Progress], Any]


class Best(ca.Callback):
    """Follows IPOPT: tells the watcher, remembers the best iterate of a run."""

    def __init__(self, size: int, rows: int, objective: float, watch: Watcher | None) -> None:
        super().__init__()
        self._sizes = {"x": size, "f": 1, "g": rows, "lam_x": size, "lam_g": rows, "lam_p": 0}
        self._objective, self._watch = objective, watch
        self._begin(np.zeros(rows), np.zeros(rows))
        self.construct("best", {})

    def _begin(self, lower: Array, upper: Array) -> None:
        self._lower, self._upper = lower, upper
        self._merit = np.inf
        self._count = 0
        self.w: Array | None = None
        self.status = ""
        self.error: Exception | None = None

    @property
    def stopped(self) -> bool:
        """Whether the solver was told to stop."""
        return bool(self.status)

    @contextmanager
    def following(self, lower: Array, upper: Array) -> Iterator[None]:
        """A run with these limits of rows; Ctrl-C meanwhile stops the solver after its iteration; a second time it raises, as usual."""
        self._begin(lower, upper)
        with on_interrupt(self._stop, then_raise=False):
            yield

    def _stop(self) -> None:
        self.status = STOPPED

    def get_n_in(self) -> int:
        """As `nlpsol` has outputs."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """One: whether to stop."""
        return 1

    def get_name_in(self, i: int) -> str:
        """As `nlpsol` names its outputs."""
        return str(ca.nlpsol_out(i))

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """As `nlpsol` sizes its outputs."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def has_eval_buffer(self) -> bool:
        """Memory instead of matrices, whose conversion takes as long as a whole evaluation of the program."""
        return True

    def eval_buffer(self, arg: Sequence[memoryview], res: Sequence[memoryview]) -> int:
        """0 into `res` to go on, 1 to stop."""
        w, f, g = (np.frombuffer(arg[ca.nlpsol_out().index(name)] or b"") for name in ("x", "f", "g"))
        violation = float(np.maximum(np.maximum(self._lower - g, g - self._upper), 0.0).max(initial=0.0))
        # the least violation counts, until it is small; then the objective
        merit = violation if violation > NEAR else NEAR * float(np.arctan(f[0]) / np.pi)
        if np.isfinite(merit) and merit < self._merit:
            self._merit, self.w = merit, w.copy()
        try:
            proceed = self._watch is None or self._watch(Progress(self._count, float(f[0]) * self._objective, violation)) is not False
        except KeyboardInterrupt:
            proceed = False
        except Exception as error:  # noqa: BLE001  # raised again once the solver has stopped, which would make a failure of it
            self.error, proceed = error, False
        self._count += 1
        if not proceed:
            self.status = STOPPED
        np.frombuffer(res[0])[:] = float(bool(self.status))
        return 0
