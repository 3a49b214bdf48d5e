"""Single run of a model by a kernel."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.simulation.control_input import SampledControl
from tenscasadi.simulation.engine.kernel import BROKEN_BARS, SHORTEST, Kernel, Watch, build_kernel
from tenscasadi.simulation.engine.request import (
    BEYOND,
    BROKEN,
    FINISHED,
    KINETIC,
    NOT_FINITE,
    STOPPED,
    STUCK,
    SUPPLIED,
    TIRED,
    Intervals,
    Rolled,
    RunPiece,
    gather_steps,
)
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.engine.sundials_runs import SundialsRuns
from tenscasadi.simulation.trajectory import name_measures, observe_states
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.validate import Array, Indices

FAULTS = {
    NOT_FINITE: "the state is not finite",
    BEYOND: "the state is beyond any physical size",
    BROKEN: f"a bar is off by more than {BROKEN_BARS:.0%} of its length",
}


class Request(NamedTuple):
    """Input of one run.

    It starts at `start` (nx,). `inputs` holds w = (u, p) of each step. Every `every`-th step is
    saved.
    """

    model: Model
    scheme: Scheme
    correction: Correction | None
    start: Array
    inputs: SampledControl
    every: int
    account: Account
    compiled: Compiled


class Run(NamedTuple):
    """Saved rows and status of one run.

    The rows end at the last good state. `states` (T, nx), `controls` (T, nw), `energy` and
    `supplied` (T,) [J] belong to `time` (T,) [s]. Energies are those under the control of the step
    before a row. See `Rolled` for `corrected` (T, 2) and `name_measures` for `observed`. A
    repetition of the run starts from `pieces`. `found` is the time [s] at which `status` was
    detected.
    """

    time: Array
    states: Array
    controls: Array
    energy: Array
    supplied: Array
    corrected: Array
    observed: dict[str, Array]
    pieces: list[RunPiece]
    status: int
    found: float
    failure: str
    text: str
    step: float
    attempts: int
    seconds: float
    compiled: bool
    note: str

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C stopped the run."""
        return self.status == STOPPED and not self.failure


def roll(request: Request, limit: float = np.inf, progress: bool = False) -> Run:
    """Run a request.

    `limit` is its wall time [s]. Raises CompileError, ValueError.
    """
    model, inputs = request.model, request.inputs
    kept, controls = _reserve(inputs.steps, request.every, model)
    kernel = make_kernel(request)
    pieces: list[RunPiece] = []
    began, deadline = time.perf_counter(), time.monotonic() + limit
    with (
        tqdm(total=inputs.steps, unit=" steps", unit_scale=True, disable=not progress) as bar,
        np.errstate(all="ignore"),
    ):
        rolled = kernel.march(
            request.start[None],
            _lay_pieces(inputs, kept, controls, pieces),
            inputs.steps,
            request.every,
            look_every=max(1, inputs.steps // 100),
            longest=inputs.longest,
            watch=Watch(lambda done: bar.update(done - bar.n), deadline),
        )
    seconds = time.perf_counter() - began
    late = time.monotonic() > deadline
    return _gather(request, kernel, rolled, kept, controls, pieces, seconds, limit if late else 0.0)


def make_kernel(request: Request) -> Kernel:
    """Build the kernel of a request.

    Raises CompileError, ValueError.
    """
    return build_kernel(
        request.model,
        request.scheme,
        request.correction,
        measured="all",
        account=request.account,
        lanes=1,
        compiled=request.compiled,
    )


def _reserve(steps: int, every: int, model: Model) -> tuple[Indices, Array]:
    """Choose the saved steps and allocate their controls."""
    try:
        kept = np.append(np.arange(0, steps, every), steps)
        return kept, np.empty((len(kept), model.nw))
    except MemoryError:
        raise ValueError(
            f"save_every is {every}: {steps / every:.2g} rows do not fit into memory, give a larger save_every or a larger step"
        ) from None


def _lay_pieces(
    inputs: SampledControl, kept: Indices, controls: Array, pieces: list[RunPiece]
) -> Iterator[RunPiece]:
    """Generate the steps of a run in growing pieces.

    Fills `controls` (T, nw) of the saved rows.
    """
    if not inputs.varies and inputs.ends is None:
        controls[:] = inputs.window(0, 1)
        whole = Intervals(*(np.array([value]) for value in (0, inputs.steps, inputs.step)))
        pieces.append(RunPiece(whole, inputs.window(0, 1)[None]))
        yield pieces[0]
        return
    first, most = 0, 32
    while first < inputs.steps:
        count = min(most, inputs.steps - first)
        held = inputs.window(first, count)
        here = (kept >= first) & (kept < first + count)
        controls[here] = held[kept[here] - first]
        controls[kept >= first + count] = held[-1]
        piece = gather_steps(held, inputs.lengths(first, count))
        if first < 2**20:  # longer runs are not repeated: memory
            pieces.append(piece)
        yield piece
        first, most = first + count, min(2 * most, 65536)


def _gather(
    request: Request,
    kernel: Kernel,
    rolled: Rolled,
    kept: Indices,
    controls: Array,
    pieces: list[RunPiece],
    seconds: float,
    late: float,
) -> Run:
    """Assemble the good rows of a run.

    A run that stopped between two saved rows also keeps its last state.
    """
    inputs = request.inputs
    if rolled.saved is None or rolled.measured is None:
        raise RuntimeError("the kernel has kept no rows")
    status, fault, good = (int(codes[0]) for codes in (rolled.status, rolled.fault, rolled.good))
    last = good if status in FAULTS else fault if status else inputs.steps
    count = max(1, int(np.searchsorted(kept, last, side="right")))
    rows, states = kept[:count], rolled.saved[0, :count]
    states[0] = request.start
    corrected = np.zeros((count, 2)) if rolled.corrected is None else rolled.corrected[0, :count]
    supplied = rolled.measured[0, :count, SUPPLIED]
    energy = rolled.measured[0, :count, KINETIC:SUPPLIED].sum(axis=1)
    if request.correction is not None and request.scheme.adaptive:
        corrected = np.full((count, 2), np.nan)
    used = controls[:count]
    if status >= STOPPED and rows[-1] < last:
        rows, states = np.append(rows, last), np.vstack([states, rolled.states])
        used, corrected = np.vstack([used, used[-1:]]), np.vstack([corrected, corrected[-1:]])
        supplied = np.append(supplied, rolled.supplied)
        at_end = _observe(request, kernel, states[-1:], used[-1:])
        energy = np.append(energy, at_end["energy"].sum())
    text, mean, attempts = _describe(request, kernel, rolled, int(rows[-1]))
    return Run(
        time=inputs.times(rows),
        states=states,
        controls=used,
        energy=energy,
        supplied=supplied,
        corrected=corrected,
        observed=_observe(request, kernel, states, used),
        pieces=pieces,
        status=status,
        found=float(inputs.times(np.array([max(fault, 0)]))[0]),
        failure=_explain(request, kernel, rolled, late),
        text=text,
        step=mean,
        attempts=attempts,
        seconds=seconds,
        compiled=kernel.lanes > 0,
        note="; in single precision"
        if isinstance(request.compiled, Single)
        else kernel.note and f"; {kernel.note}",
    )


def _observe(request: Request, kernel: Kernel, states: Array, inputs: Array) -> dict[str, Array]:
    """Measure states in double precision.

    States are (T, nx), inputs (T, nw).
    """
    with np.errstate(all="ignore"):
        if isinstance(request.compiled, Single):
            return observe_states(request.model, states, inputs)
        return name_measures(request.model, states, kernel.observe(states, inputs))


def _describe(
    request: Request, kernel: Kernel, rolled: Rolled, taken: int
) -> tuple[str, float, int]:
    """Describe the steps of a run.

    Returns the text, the mean step [s] and the number of computed steps; `taken` counts the grid
    steps.
    """
    scheme, inputs = request.scheme, request.inputs
    step, name = inputs.step, type(scheme).__name__
    if isinstance(kernel.backend, SundialsRuns):
        events, trials = kernel.backend.located
        located = f", {trials} trials to locate {events} events" if events else ""
        return f"{taken} times {step:g} s apart, by {name}{located}", step, taken
    if not kernel.trials:
        return f"{taken} steps of {step:g} s", step, taken
    m = rolled.memory[0]
    covered = float(inputs.times(np.array([taken]))[0]) + (step - m.rest if m.rest > 0 else 0.0)
    mean = covered / m.accepted if m.accepted else step
    text = f"{m.accepted:.0f} steps of {mean:.3g} s in the mean, {m.rejected:.0f} more rejected"
    text += f", {m.located:.0f} to locate {m.events:.0f} events" if m.events else ""
    return text, mean, round(m.accepted + m.rejected + m.located)


def _explain(request: Request, kernel: Kernel, rolled: Rolled, late: float) -> str:
    """Explain why a run ended early, with a cure.

    Returns "" for a complete run and after Ctrl-C.
    """
    status, scheme = int(rolled.status[0]), request.scheme
    name, step = type(scheme).__name__, request.inputs.longest
    if status == FINISHED:
        return ""
    if status == STOPPED:
        over = f"seconds = {late:g} of wall time are over"
        return f"{over}: give more, or a scheme and step that take less" if late else ""
    if status == STUCK:
        return (
            f"{name} needs steps shorter than {SHORTEST * step:.2g} s: the motion breaks down here, "
            f"or rtol={getattr(scheme, 'rtol', 0.0):g} asks for more than rounding leaves"
        )
    if status == TIRED:
        return (
            f"{kernel.trials} attempts did not reach the end of a grid step of {step:g} s, "
            f"the last of {rolled.memory[0].step:.2g} s: "
            f"try a larger {name}(rtol), a smaller step, an implicit scheme or a larger max_attempts"
        )
    if status == NOT_FINITE and kernel.trials:
        return "the state is not finite, whatever the step: give a start that can move"
    if status in FAULTS:
        return ""
    if isinstance(kernel.backend, SundialsRuns) and isinstance(scheme, Sundials):
        return _explain_sundials(scheme, kernel.backend.failure)
    return "CasADi could not evaluate a step: try a smaller step"


def _explain_sundials(scheme: Sundials, failure: str) -> str:
    found = re.search(r'(\w+) returned "(\w+)"', failure)
    words = f"{found[1]} returned {found[2]}" if found else failure.strip().splitlines()[-1]
    # At a loose tolerance, excessive steps indicate that the motion itself broke down.
    tight = scheme.rtol <= 1e-5
    cure = (
        "a larger rtol, a smaller step or a larger max_steps" if tight else "a smaller rtol or step"
    )
    return f"{type(scheme).__name__} gave up, {words}: rtol is {scheme.rtol:g}, try {cure}"
