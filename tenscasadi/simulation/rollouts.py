"""Rollouts: batches of runs of one model."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from tenscasadi.dynamics.mechanism import Mechanism
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.simulation.engine.request import WORST
from tenscasadi.simulation.engine.roll import Request, Runs, roll
from tenscasadi.simulation.engine.step_code import Account
from tenscasadi.simulation.inputs.run_inputs import read_inputs
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.simulate import check_options
from tenscasadi.simulation.verdict.judge import judge
from tenscasadi.simulation.verdict.step_error import estimate_errors
from tenscasadi.structure.names import add_names, name_errors
from tenscasadi.util.compile import Compiled
from tenscasadi.util.processes import count_processors
from tenscasadi.util.validate import Array, positive_number, whole_number


@name_errors
def rollouts(  # noqa: PLR0913  the options of a batch
    model: Model,
    t_end: float,
    step: float | None = None,
    states: Any = None,
    controls: Any = None,
    parameters: Any = None,
    scheme: Scheme = RungeKutta4(),
    correction: Correction | None = None,
    save_every: int | None = None,
    threads: int | None = None,
    *,
    compiled: Compiled = None,
    progress: bool = False,
    energy_balance: bool = True,
    time_limit: float | None = None,
    verify: bool = False,
) -> Rollouts:
    """Simulate a batch of runs of one model.

    The runs start at time 0 and differ in start, control and parameters.

    Parameters
    ----------
    model : Model
        Model of all runs.
    t_end : float
        End of the runs [s].
    step : float, optional
        Largest step [s], with the default of `simulate` at the first initial state.
    states : array_like, shape (n, nx) or (nx,), optional
        Initial state of each run, or of all. Default: `model.initial_state`.
    controls : array_like, callable or Feedback, optional
        Constant control (n, nu), or control (n, K, nu) that is constant on each of K equal parts of
        [0, t_end]. All runs share (nu,), (1, K, nu) or a function of time, as for `simulate`. A
        `Feedback` depends on the state of each run. Default: `model.initial_control`.
    parameters : array_like, shape (n, np) or (np,), or mapping of str to array_like, optional
        Values of the model's parameters in each run, or in all. Values by name are (n, k) or as in
        `ParameterLayout.values`; the others are nominal. One compiled code serves all values.
    scheme : Scheme
        Integration scheme. Explicit schemes with fixed steps compute several runs at once.
    correction : Projection or BarLengthCorrection, optional
        Correction after every `correction.every`-th step. Default: none.
    save_every : int, optional
        Number of steps between saved rows; the first and the last state are always saved. Default:
        only these two.
    threads : int, optional
        Threads that share the runs. Default: one for each available processor.
    compiled : bool or Single, optional
        As for `simulate`. `Single()` computes twice as many runs per instruction.
    progress : bool
        Whether to show a progress bar.
    energy_balance : bool
        Whether to integrate the work of damping, contact and control, as for `simulate`. Without
        it, `energy_error` is NaN where it depends on that work.
    time_limit : float, optional
        Wall time after which runs stop [s], as after Ctrl-C. Default: no limit.
    verify : bool
        Whether to repeat finished runs with other steps, as `simulate` does. `error_estimate` then
        contains their step-size errors.

    Returns
    -------
    Rollouts
        Runs at the saved times, each with its errors and its message. A diverging run does not
        affect the others. Ctrl-C stops unfinished runs and keeps the others.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the saved rows exceed the memory.

    See Also
    --------
    simulate : One run, with its forces.

    Notes
    -----
    Long computations are compiled once for a model, with several runs in the lanes of each
    instruction: 8 with AVX-512, 4 with AVX, else 2. Each result equals that of `simulate` to the
    last bit. Schemes with error control and code that branches on numbers, such as splines, advance
    one run at a time. In short computations and without a C++ compiler, CasADi computes the same
    numbers more slowly, and `lanes` is 0.

    Examples
    --------
    Simulate a hundred pendulums with random initial velocities:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> starts = np.tile(model.initial_state, (100, 1))
    >>> pushed = tc.build_projection(model).map(100)(starts.T + np.random.default_rng(0).normal(0, 0.1, starts.T.shape)).full().T
    >>> many = tc.rollouts(model, t_end=1.0, step=5e-3, states=pushed, correction=tc.Projection())
    >>> bool(many.success.all()), many.final.shape, bool(many.energy_error.max() < 1e-5)
    (True, (100, 6), True)
    """
    flags = {"progress": progress, "energy_balance": energy_balance, "verify": verify}
    compiled = check_options(model, scheme, correction, compiled, **flags)
    limit = np.inf if time_limit is None else positive_number("time_limit", time_limit)
    inputs = read_inputs(model, t_end, step, scheme, states, controls, parameters, many=True)
    steps, n = inputs.grid.steps, inputs.runs
    every = steps if save_every is None else whole_number("save_every", save_every, 1)
    workers = count_processors() if threads is None else whole_number("threads", threads, 1, 1024)
    varies = inputs.controls.shape[1] > 1 or inputs.feedback is not None
    request = Request(
        inputs,
        scheme,
        correction,
        every,
        Account(energy_balance and inputs.model.power is not None, energy_balance and varies),
        "errors",
        compiled,
        threads=min(workers, max(n, 1)),
        time_limit=limit,
        deadline=time.monotonic() + limit,
    )
    return _record(model, roll(request, progress), verify)


def _record(model: Model, runs: Runs, verify: bool) -> Rollouts:
    """Convert computed runs to rollouts with acceptance tests.

    With `verify`, runs are repeated with other steps to estimate the error.
    """
    request, rolled = runs.request, runs.rolled
    grid, steps = request.inputs.grid, request.inputs.grid.steps
    saved = np.append(np.arange(0, steps, request.every), steps)
    times, verdict = grid.times(saved), judge(runs, estimate_errors(runs) if verify else None)
    worst = dict(
        zip(
            WORST,
            np.zeros((len(WORST), 0)) if rolled.worst is None else rolled.worst.T,
            strict=True,
        )
    )
    place, given = _find_places(request.inputs.base, request.inputs.first + times)
    energy = runs.measured[:, :, 2:5].sum(axis=2)
    named = [add_names(text, model.structure) for text in verdict.message]
    return Rollouts(
        time=times,
        states=runs.saved[:, :, : model.nx],
        success=verdict.success,
        message=np.array(named, dtype=np.str_).reshape(len(energy)),
        bar_length_error=worst["bar_length_error"],
        joint_error=worst["joint_error"],
        energy=energy,
        energy_error=worst["energy_error"] if request.balanced else np.full(len(energy), np.nan),
        place=place,
        given=given,
        step=grid.step,
        steps=steps,
        seconds=runs.seconds,
        lanes=runs.kernel.lanes,
        note=runs.kernel.note,
        threads=request.threads,
        interrupted=runs.stopped and not runs.late,
        bars=model.structure.bars,
        scene=model.scene,
        strings=model.structure.strings,
        pinned=np.array(sorted({*model.structure.pinned, *model.structure.rollers}), dtype=np.intp),
        turn=model.mechanism.frames_of_nodes[model.mechanism.first]
        if model.mechanism.turn is not None
        else np.zeros((0, 3, 3)),
        follow=_find_weights(model.mechanism),
        error_estimate=verdict.error,
    )


def _find_weights(mech: Mechanism) -> Array:
    """Find nodes that are affine combinations of others, with weights.

    They are nodes of a mechanism. The result (w, 3) has the dependent node, an independent node,
    and its weight in each row.
    """
    if mech.spread is None:
        return np.zeros((0, 3))
    weights = mech.spread.tocoo()
    own = mech.dependent[weights.row]
    return np.column_stack([weights.row[own], weights.col[own], weights.data[own]])


def _find_places(model: Model, clock: Array) -> tuple[Any, Array]:
    """Find where each node coordinate is in the state.

    `clock` (T,) contains the times of the rows [s]. Entries (N, 3) are -1 for coordinates that are
    not in the state. Also returns the prescribed coordinates (T, N, 3), NaN for those in the state.
    """
    place = model.entries
    probes = np.zeros((len(clock), model.nx))
    if model.scene.has_clock:
        model.split(probes).clock[:] = clock[:, None]
    local = model.mechanism.local(model.nodes(probes).reshape(len(probes), place.size)).reshape(
        -1, *place.shape
    )
    return place, np.where(place >= 0, np.nan, local)
