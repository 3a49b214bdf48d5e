"""Rollouts: batches of runs of one model."""

from __future__ import annotations

import os
import time as clock
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import Correction, check_correction
from tenscasadi.simulation.engine.inputs import (
    controls_at,
    first_time,
    gather_intervals,
    lay_steps,
    read_controls,
    read_parameters,
    read_starts,
)
from tenscasadi.simulation.engine.kernel import Kernel, Watch, build_kernel
from tenscasadi.simulation.engine.request import (
    KINETIC,
    MEASURED,
    STOPPED,
    SUPPLIED,
    count_runs,
)
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.time_grid import describe_unseen
from tenscasadi.simulation.verdict import Runs, judge
from tenscasadi.util.validate import flag, instance, whole_number


def rollouts(
    model: Model,
    t_end: float,
    step: float = 1e-3,
    states: Any = None,
    controls: Any = None,
    parameters: Any = None,
    scheme: Scheme = RungeKutta4(),
    correction: Correction | None = None,
    save_every: int | None = None,
    threads: int | None = None,
    *,
    progress: bool = False,
) -> Rollouts:
    """Simulate a batch of runs of one model.

    The runs start at time 0 and differ in start, control and parameters.

    Parameters
    ----------
    model : Model
        Model of all runs.
    t_end : float
        End of the runs [s].
    step : float
        Largest step [s], as for `simulate`.
    states : array_like, shape (n, nx) or (nx,), optional
        Initial state of each run, or of all. Default: `model.initial_state`.
    controls : array_like or Feedback, optional
        Constant control (n, nu), or control (n, K, nu) that is constant on each of K equal parts of
        [0, t_end]. All runs share (nu,) or (1, K, nu). A `Feedback` depends on the state of each
        run. Default: `model.initial_control`.
    parameters : array_like, shape (n, np) or (np,), or mapping of str to array_like, optional
        Values of the model's parameters in each run, or in all. Values by name are (n, k) or as in
        `ParameterLayout.values`; the others are nominal. One compiled code serves all values.
    scheme : Scheme
        Scheme of fixed, explicit steps: `RungeKutta4`, `Rattle`, `DormandPrince54()` or
        `DormandPrince853()` without `rtol`.
    correction : Projection or BarLengthCorrection, optional
        Correction after every `correction.every`-th step. Default: none.
    save_every : int, optional
        Number of steps between saved rows; the first and the last state are always saved. Default:
        only these two.
    threads : int, optional
        Threads that share the runs. Default: one for each available processor.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Rollouts
        Motions at the saved times, each with its errors and its message. A run that diverges does
        not affect the others. Ctrl-C stops unfinished runs and keeps the others.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the saved rows exceed the memory.

    See Also
    --------
    simulate : One run, with its forces.

    Notes
    -----
    The steps are compiled once for a model, with several runs in the lanes of each instruction: 8
    with AVX-512, 4 with AVX, else 2. Each result equals that of `simulate` to the last bit. Code
    that branches on numbers, such as splines, advances one run at a time. Without a C++ compiler,
    CasADi computes the same numbers more slowly, and `lanes` is 0.

    Examples
    --------
    Simulate a hundred pendulums with random initial velocities:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> starts = np.tile(model.initial_state, (100, 1))
    >>> pushed = tc.projection(model).map(100)(starts.T + np.random.default_rng(0).normal(0, 0.1, starts.T.shape)).full().T
    >>> many = tc.rollouts(model, t_end=1.0, step=5e-3, states=pushed, correction=tc.Projection())
    >>> bool(many.success.all()), many.final.shape, bool(many.energy_error.max() < 1e-5)
    (True, (100, 6), True)
    """
    instance("model", model, Model, "a tenscasadi.Model")
    check_scheme(scheme)
    check_correction(correction)
    flag("progress", progress)
    p = read_parameters(model, parameters)
    starts = read_starts(model, states, p)
    plan = read_controls(model, controls, p)
    n = count_runs(states=len(starts), controls=len(plan.controls), parameters=len(p))
    inputs = lay_steps(model, starts, t_end, step, plan)
    every = inputs.steps if save_every is None else whole_number("save_every", save_every, 1)
    workers = min(
        _processors() if threads is None else whole_number("threads", threads, 1, 1024), max(n, 1)
    )
    _check_memory(n, 1 - (-inputs.steps // every), model.nx)
    kept = np.append(np.arange(0, inputs.steps, every), inputs.steps)
    kernel = build_kernel(model, scheme, correction, measured=True)
    intervals, feedback = gather_intervals(model, inputs, plan)
    began = clock.perf_counter()
    with (
        tqdm(total=n * inputs.steps, unit=" steps", unit_scale=True, disable=not progress) as bar,
        np.errstate(all="ignore"),
    ):
        result = kernel.run(
            starts,
            plan.controls,
            intervals,
            every,
            look_every=max(1, inputs.steps // 100),
            parameters=p,
            feedback=feedback,
            threads=workers,
            longest=inputs.longest,
            watch=Watch(lambda done: bar.update(done - bar.n)),
        )
    seconds = clock.perf_counter() - began
    time = inputs.times(kept)
    run = Runs(
        model,
        scheme,
        starts,
        plan.controls,
        p,
        inputs.steps,
        inputs.step,
        time,
        lambda step: float(inputs.times(np.array([step]))[0]),
        lambda k: controls_at(plan, model, time, result.saved, k),
        result,
        describe_unseen(
            model.over_time, inputs, first_time(model, starts), inputs.step, scheme.order
        ),
    )
    return _record(run, kernel, workers, seconds)


def _check_memory(n: int, rows: int, nx: int) -> None:
    """Raise ValueError if the results do not fit into memory."""
    needed = 8.0 * n * rows * (2 * nx + len(MEASURED) + 2)  # including derived arrays
    free = _free_memory()
    if needed > free:
        told = f"save_every: {n} motions of {rows} rows take {needed / 1e9:.3g} GB, {free / 1e9:.3g} GB are free"
        raise ValueError(f"{told}: give a larger save_every, or fewer motions at a time")


def _free_memory() -> float:
    """Read the free memory in bytes; inf if unknown."""
    try:
        told = Path("/proc/meminfo").read_text(encoding="ascii")
        return 1024.0 * float(told.split("MemAvailable:")[1].split()[0])
    except (OSError, IndexError, ValueError):
        try:
            return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        except (AttributeError, ValueError, OSError):
            return np.inf


def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def _record(run: Runs, kernel: Kernel, threads: int, seconds: float) -> Rollouts:
    model, result = run.model, run.result
    if result.saved is None or result.measured is None or result.worst is None:
        raise RuntimeError("the kernel has measured nothing")
    success, message = judge(run)
    indices = np.full(model.mechanism.N.T.size, -1, dtype=np.intp)
    indices[model.mechanism.free_index] = np.arange(model.nq)
    place = indices.reshape(-1, 3)[model.mechanism.first]
    probes = np.zeros((len(run.time), model.nx))
    if model.scene.has_clock and len(run.starts):
        clocks = model.split(run.starts)[2]
        model.split(probes)[2][:] = run.time[:, None] + clocks[np.argmax(np.isfinite(clocks))]
    local = model.mechanism.local(model.nodes(probes).reshape(len(probes), place.size)).reshape(
        -1, *place.shape
    )
    given = np.where(place >= 0, np.nan, local)
    worst = result.worst
    return Rollouts(
        time=run.time,
        states=result.saved,
        success=success,
        message=message,
        bar_length_error=worst[:, 0],
        joint_error=worst[:, 1],
        energy=result.measured[:, :, KINETIC:SUPPLIED].sum(axis=2),
        energy_error=worst[:, 2],
        place=place,
        given=given,
        step=run.step,
        steps=run.steps,
        seconds=seconds,
        lanes=kernel.lanes,
        note=kernel.note,
        threads=threads,
        interrupted=bool(np.any(result.status == STOPPED)),
        bars=model.structure.bars,
        scene=model.scene,
        strings=model.structure.strings,
        pinned=np.array(sorted({*model.structure.pinned, *model.structure.rollers}), dtype=np.intp),
        turn=model.mechanism.frames_of_nodes,
    )
