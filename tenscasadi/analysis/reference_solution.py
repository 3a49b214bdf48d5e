"""Reference solutions with an error estimate.

Two tight solutions by different schemes and steps are compared at the end.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np
from tqdm import tqdm

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_events
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853
from tenscasadi.integrators.scheme import Scheme, extent
from tenscasadi.integrators.stability import find_limit
from tenscasadi.schema.field_types import POINTS
from tenscasadi.schema.value import check_fields
from tenscasadi.simulation.engine.roll import COMPARED
from tenscasadi.simulation.inputs.controls import ControlInput
from tenscasadi.simulation.inputs.resolution import UNRESOLVED
from tenscasadi.simulation.inputs.run_inputs import read_inputs
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import read_compiled
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    Array,
    NonNegative,
    Positive,
    finite_array,
    flag,
    positive_number,
)

_FINER = 4  # refinement factor between pairs of solutions
_TOLERANCES = (1e-10, 1e-12, 1e-14)
GRID = 20  # grid steps of a run with error control
_ROUNDING = 1e-10  # × extent: smaller differences stop decreasing because of rounding


class NoReferenceError(ValueError):
    """Raised if both schemes of a reference solution disagree.

    The trajectory is chaotic, unstable or too stiff for errors to be measured.
    """


@dataclass(frozen=True, eq=False)
class ReferenceSolution:
    """Final node positions with an error estimate.

    Attributes
    ----------
    nodes : ndarray (n, 3)
        Nodes of the scene's structure at `t_end` [m], read-only, without those inside strings.
    error : float
        Estimate of their error [m]: the largest distance of a node between two solutions by
        different schemes and steps.
    t_end : float
        Final time [s].
    message : str
        Description of the two solutions.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.ReferenceSolution(nodes=[(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], error=1e-12, t_end=1.0).nodes.shape
    (2, 3)
    """

    nodes: Annotated[Array, POINTS]
    error: NonNegative
    t_end: Positive
    message: str = ""

    def __post_init__(self) -> None:
        check_fields(self)


@rename_keywords(
    accuracy="max_difference",
    enough="target_difference",
    work="max_instructions",
    seconds="time_limit",
)
def reference_solution(
    model: Model,
    t_end: float,
    state: Any = None,
    control: ControlInput = None,
    max_difference: float | None = None,
    target_difference: float | None = None,
    compiled: bool | None = None,
    max_instructions: float = 1e10,
    parameters: Any = None,
    time_limit: float | None = None,
    progress: bool | None = False,
) -> ReferenceSolution:
    """Compute a reference solution with an error estimate.

    `DormandPrince853` and `DormandPrince54` refine their steps until their final nodes agree within
    `target_difference`. Refinement also ends if finer steps do not reduce the difference, or if the
    next solution would cost more than `max_instructions`. In scenes with slack strings or contacts,
    both schemes control their error and locate these events. Steps end at the breakpoints of functions of time.
    A solution that does not resolve such a function is no reference. The error includes the effect
    of clock rounding on these functions.

    Parameters
    ----------
    model : Model
        The model.
    t_end : float
        Duration of the motion [s].
    state : array_like (nx,), optional
        Initial state. Default: that of the model.
    control : array_like or callable, optional
        Control input, as for `simulate`.
    max_difference : float, optional
        Largest accepted distance of the two solutions [m]. Default: 1e-7 of the structure's size.
    target_difference : float, optional
        Distance of the two solutions at which refinement ends [m]. Default: 1e-12 of the
        structure's size.
    compiled : bool, optional
        Whether to run as machine code, as for `simulate`.
    max_instructions : float
        Largest number of instructions of one solution; a tenth of it without machine code.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters, see `ParameterLayout.values`. Default: nominal values.
    time_limit : float, optional
        Limit of the wall time of all solutions [s]. The best pair by then counts. Default: no
        limit.
    progress : bool, optional
        Whether to show a progress bar after two seconds. None: if standard error is a terminal.

    Returns
    -------
    ReferenceSolution
        Final positions of the nodes and their error [m].

    Raises
    ------
    NoReferenceError
        If the two solutions end further apart than `max_difference`.
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> reference = tc.reference_solution(model, t_end=0.5, target_difference=1e-8, compiled=False)
    >>> reference.error < 1e-8
    True
    """
    check_model(model)
    way = read_compiled("compiled", compiled)
    t_end = positive_number("t_end", t_end)
    state = None if state is None else finite_array("state", state, (model.nx,))
    size = extent(model)
    max_difference = (
        1e-7 * size if max_difference is None else positive_number("max_difference", max_difference)
    )
    # The rounding error of a run is about 1e-12 of the extent.
    target_difference = (
        min(1e-12 * size, max_difference)
        if target_difference is None
        else positive_number("target_difference", target_difference)
    )
    # Compiled code is about ten times as fast.
    max_instructions = positive_number("max_instructions", max_instructions) / (
        1 if way is not False else 10.0
    )
    parameters = model.parameters.values(parameters)
    deadline = (
        np.inf
        if time_limit is None
        else time.perf_counter() + positive_number("time_limit", time_limit)
    )
    pairs = _Pairs(
        model,
        t_end,
        deadline,
        {"state": state, "control": control, "compiled": way, "parameters": parameters},
    )
    target_difference = max(target_difference, 2 * pairs.rounding)
    floor = _ROUNDING * size
    counts = _step_counts(model, t_end, state, max_instructions, parameters)
    with show_progress(progress, " runs of the reference") as pairs.progress_bar:
        _refine_steps(pairs, counts, target_difference, max(max_difference, floor))
        if pairs.apart > floor and (pairs.has_events or model.scene.over_time):
            for rtol in _TOLERANCES:
                if pairs.late or pairs.error <= target_difference:
                    break
                pairs.try_tolerance(rtol)
    if pairs.best is not None and pairs.error <= max_difference:
        return pairs.best
    raise add_address(NoReferenceError(_explain_failure(pairs, t_end, max_difference, time_limit)))


def show_progress(progress: bool | None, unit: str, total: int | None = None) -> Any:
    """Build a progress bar that appears after two seconds.

    It counts `total` items of a `unit`; None means an unknown total. With `progress` None, it is
    shown if standard error is a terminal. Raises TypeError.
    """
    if progress is not None:
        flag("progress", progress)
    hidden = None if progress is None else not progress
    return tqdm(total=total, unit=unit, delay=2.0, disable=hidden, leave=False)


def _refine_steps(pairs: _Pairs, counts: Iterable[int], target: float, accepted: float) -> None:
    """Solve with finer steps until both schemes agree.

    `counts` are the numbers of steps to try. The difference of both schemes is then at most
    `target` [m]. Refinement also ends if the difference no longer decreases and is at most
    `accepted` [m].
    """
    for count in counts:
        before = pairs.apart
        pairs.try_steps(count)
        if pairs.late or pairs.error <= target:
            return
        if pairs.apart >= before and pairs.error <= accepted:
            return  # finer steps only increase the rounding
        if pairs.apart > before / _FINER**3 and pairs.has_events:
            return


def _explain_failure(
    pairs: _Pairs, t_end: float, max_difference: float, time_limit: float | None
) -> str:
    why = (
        f"{pairs.best.message}, wanted {max_difference:.2g} m"
        if pairs.best is not None
        else f"the solutions diverge, the last: {pairs.fault}"
    )
    why += f"; the time limit of {time_limit:g} s expired" if pairs.late else ""
    return (
        f"no reference up to t_end = {t_end:g} s: {why}; give a smaller t_end (chaotic and unstable motions lose all digits), "
        "a larger max_difference or max_instructions, or remove slack and impact events by Smooth(width)"
    )


class _Pairs:
    """Best pair of solutions by two schemes, and the last difference.

    The difference is infinite if one of the two fails.
    """

    def __init__(
        self, model: Model, t_end: float, deadline: float, options: dict[str, Any]
    ) -> None:
        self._model, self._t_end, self._deadline = model, t_end, deadline
        self._options = {**options, "energy_balance": False}
        self.has_events = build_events(model) is not None
        self.best: ReferenceSolution | None = None
        self.apart, self.fault = np.inf, "not tried"
        self.progress_bar: Any = None
        self.rounding = self._round_clock()

    @property
    def error(self) -> float:
        """Error of the best pair [m]; infinite without one."""
        return np.inf if self.best is None else self.best.error

    @property
    def late(self) -> bool:
        """Whether the time limit has expired."""
        return time.perf_counter() > self._deadline

    def try_steps(self, count: int) -> None:
        """Solve with fixed steps of both schemes.

        Order 8 takes `count` steps and order 5 about four times as many. The number is not a
        multiple, so the two meet events at different places of a step.
        """
        finer = _FINER * count + 1
        self._try(
            f"DormandPrince853 with {count} steps and DormandPrince54 with {finer}",
            (DormandPrince853(), count),
            (DormandPrince54(), finer),
        )

    def try_tolerance(self, rtol: float) -> None:
        """Solve with error control and event location of both schemes.

        `rtol` is the relative tolerance of both.
        """
        first, second = DormandPrince853(rtol), DormandPrince54(rtol)
        self._try(
            f"DormandPrince853 and DormandPrince54 with rtol={rtol:g}",
            (first, GRID),
            (second, GRID + 1),
        )

    def _round_clock(self) -> float:
        """Bound the position error due to rounding of the clock [m].

        Functions and tables of time are evaluated at a time with this rounding error. It is
        estimated as if their changes acted, too early or too late, from the start on.
        """
        model, state = self._model, self._options["state"]
        p = self._options["parameters"]
        inputs = read_inputs(
            model,
            self._t_end,
            self._t_end / GRID,
            DormandPrince853(_TOLERANCES[0]),
            state,
            self._options["control"],
            p,
            many=False,
        )
        model, start, grid = inputs.model, inputs.starts[0], inputs.grid
        if not model.over_time:
            return 0.0
        times = start[-1] + grid.times(np.arange(grid.steps + 1))
        states = np.tile(start, (len(times), 1))
        model.split(states).clock[:, 0] = times
        held = np.tile(inputs.stack(0, np.array([0])), (len(times), 1))
        rates = (
            model.with_stacked_input(model.ode)
            .map(len(times))(states.T, held.T if model.nw else ca.DM(0, len(times)))
            .full()
            .T
        )
        own = model.split(states)
        own.velocities[:], own.clock[:] = model.split(rates).velocities, start[-1]
        changes = np.linalg.norm(np.diff(model.velocities(states), axis=0), axis=2).max(axis=1)
        late = grid.early * np.linalg.norm(model.velocities(start), axis=1).max()
        return float(
            np.nan_to_num(
                np.spacing(abs(times).max()) * (changes * (times[-1] - times[:-1])).sum() + late
            )
        )

    def _try(self, what: str, *pair: tuple[Scheme, int]) -> None:
        self.apart = np.inf
        ends = []
        for scheme, count in pair:
            left = (
                None if np.isinf(self._deadline) else max(0.1, self._deadline - time.perf_counter())
            )
            run = simulate(
                self._model,
                self._t_end,
                self._t_end / count,
                scheme,
                save_every=count,
                time_limit=left,
                verify=False,
                **self._options,
            )
            if run.interrupted:
                raise KeyboardInterrupt
            self.progress_bar.update()
            if not run.success or UNRESOLVED in run.message:
                self.fault = run.message
                return
            ends.append(end_nodes(self._model, run))
        self.apart = distance(*ends)
        if (error := self.apart + self.rounding) < self.error:
            rounded = (
                f", the clock's rounding may add {self.rounding:.2g} m"
                if self.rounding > 0.1 * self.apart
                else ""
            )
            self.best = ReferenceSolution(
                ends[0],
                error,
                self._t_end,
                f"{what} end {self.apart:.2g} m apart{rounded}",
            )


def _step_counts(
    model: Model, t_end: float, state: Any, work: float, parameters: Array
) -> Iterator[int]:
    """Yield increasing numbers of steps for the scheme of order 8.

    They grow from the stability limit at the initial `state` (nx,) to the number that `work`, a
    limit of instructions, allows. The run ends at `t_end` [s].
    """
    limits = [
        0.9 * find_limit(model, scheme, state, parameters=parameters)
        for scheme in (DormandPrince853(), DormandPrince54())
    ]
    longest = min(limits[0], _FINER * limits[1])
    steps = (
        max(COMPARED, int(np.ceil(t_end / longest)))
        if np.isfinite(longest) and longest > 0
        else COMPARED
    )
    most = work / max(1, count_instructions(DormandPrince853().advance(model)))
    yield steps
    while steps * _FINER <= most:
        steps *= _FINER
        yield steps


def end_nodes(model: Model, trajectory: Trajectory) -> Array:
    """Select the final nodes (n, 3) of the scene's structure.

    They are those of a trajectory. Nodes inside strings follow them and are omitted.
    """
    return trajectory.nodes[-1, : len(model.scene.structure.nodes)]


def distance(nodes: Array, others: Array) -> float:
    """Compute the largest distance between corresponding nodes [m].

    `nodes` and `others` are (n, 3) [m].
    """
    return float(np.linalg.norm(nodes - others, axis=1).max(initial=0.0))
