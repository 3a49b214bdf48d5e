"""Trade-off studies of speed and accuracy.

A grid of schemes, steps, corrections and models is compared with a reference solution.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import median
from typing import Any

import numpy as np
from tqdm import tqdm

from tenscasadi.analysis.reference_solution import (
    GRID,
    ReferenceSolution,
    distance,
    end_nodes,
    reference_solution,
)
from tenscasadi.analysis.tradeoff_table import Tradeoff, TradeoffRow
from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import BarLengthCorrection, Correction, Projection
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.scene.control_function import ControlFunction
from tenscasadi.simulation.inputs.controls import ControlInput
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import Compiled, CompileError, Single, find_compiler, read_compiled
from tenscasadi.util.validate import (
    MAX_REPETITIONS,
    Array,
    call_user_function,
    finite_array,
    flag,
    format_value,
    instance,
    positive_number,
    whole_number,
)

State = Array | Callable[[Model], Array] | None


def tradeoff(
    models: Model | Mapping[str, Model],
    t_end: float,
    schemes: Sequence[Scheme],
    steps: Sequence[float],
    reference: ReferenceSolution | str | None = None,
    state: State = None,
    control: ControlInput = None,
    corrections: Sequence[Correction | None] = (None,),
    compiled: Sequence[Compiled] = (None,),
    repeats: int = 3,
    progress: bool = False,
    parameters: Any = None,
) -> Tradeoff:
    """Measure the cost of accuracy in a trade-off study.

    There is a run for each combination of scheme, step, correction, model and `compiled`.

    If a run diverges or a scheme does not support a model, its row has `success` False and the
    reason in `message`. Ctrl-C ends the study and returns the rows so far, with `complete` False.

    Parameters
    ----------
    models : Model or mapping of str to Model
        A model, or several by name that share their scene's nodes and differ in fidelity: segments,
        lumping, slack, elastic bars, coordinates.
    t_end : float
        Duration of each run [s].
    schemes : sequence of schemes
        Integration schemes, such as `RungeKutta4()`.
    steps : sequence of float
        Largest steps [s]. A scheme with error control chooses its own steps, up to a twentieth of
        `t_end`, and runs once.
    reference : ReferenceSolution or str, optional
        Exact final positions, or the name of the model for which `reference_solution` computes
        them. Default: the first model.
    state : array_like (nx,) or callable, optional
        Initial state, or a function that computes it for a model. Default: that of each model.
    control : array_like or callable, optional
        Control input, as for `simulate`.
    corrections : sequence of corrections
        Each None, `Projection()` or `BarLengthCorrection()`.
    compiled : sequence
        Ways to run, each as for `simulate`: None, True, False or `Single()`.
    repeats : int
        Number of timed runs, of which the median counts.
    progress : bool
        Whether to show a progress bar.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the models' parameters, see `ParameterLayout.values`. Default: nominal values.

    Returns
    -------
    Tradeoff
        A row for each run.

    Raises
    ------
    NoReferenceError
        If the two solutions of the reference disagree.
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> reference = tc.reference_solution(model, t_end=0.2, target_difference=1e-8, compiled=False)
    >>> table = tc.tradeoff(model, 0.2, [tc.RungeKutta4()], [0.02, 0.01], reference, compiled=[False], repeats=1)
    >>> coarse, fine = table.rows
    >>> coarse.position > fine.position
    True
    """
    named = dict(models) if isinstance(models, Mapping) else {"": models}
    _check_models(named, schemes, corrections)
    t_end, repeats = (
        positive_number("t_end", t_end),
        whole_number("repeats", repeats, 1, MAX_REPETITIONS),
    )
    flag("progress", progress)
    ways = [read_compiled("compiled", way) for way in _check_sequence("compiled", compiled)]
    lengths = _read_steps(steps)
    rows: list[TradeoffRow] = []
    known: ReferenceSolution | None = None
    end = "interrupted from the keyboard before the reference was found"
    plans = list(product(named.items(), schemes, corrections, ways))
    total = sum(1 if scheme.adaptive else len(lengths) for _, scheme, _, _ in plans)
    double = False if all(way is False for way in ways) else None
    try:
        with tqdm(total=total, unit=" runs", disable=not progress) as bar:
            known = _find_reference(named, t_end, reference, state, control, double, parameters)
            for (name, model), scheme, correction, way in plans:
                start = start_of(model, state)
                case = Case(model, scheme, correction, t_end, start, control, way, parameters)
                for row in _measure_rows(case.with_code(), name, lengths, known, repeats):
                    rows.append(row)
                    bar.update()
        end = ""
    except KeyboardInterrupt:
        end = f"interrupted from the keyboard after {len(rows)} of {total} runs" if known else end
    error, told = (known.error, known.message) if known else (np.inf, "none")
    return Tradeoff(tuple(rows), t_end, error, told, complete=not end, message=end)


def _read_steps(steps: Any) -> list[float]:
    """Read the steps [s], the longest first."""
    given = enumerate(_check_sequence("steps", steps))
    return sorted({positive_number(f"steps[{i}]", step) for i, step in given}, reverse=True)


@dataclass(frozen=True, eq=False)
class Case:
    """Scheme, model and options of a run, without its step.

    Fields are named as the arguments of `simulate`, and have their meaning.
    """

    model: Model
    scheme: Scheme
    correction: Correction | None
    t_end: float
    state: Array | None
    control: ControlInput
    compiled: Compiled
    parameters: Any = None

    def with_code(self) -> Case:
        """Select machine code for time measurements.

        Otherwise short runs use it late or never. SUNDIALS and machines without a compiler have
        none.
        """
        if self.compiled is not None or isinstance(self.scheme, Sundials):
            return self
        return replace(self, compiled=find_compiler() is not None)

    def run(self, step: float, **options: Any) -> Trajectory:
        """Simulate with a step; raise KeyboardInterrupt after Ctrl-C."""
        options = {
            "t_end": self.t_end,
            "control": self.control,
            "parameters": self.parameters,
            "verify": False,
            **options,
        }
        run = simulate(
            self.model,
            step=step,
            scheme=self.scheme,
            state=self.state,
            correction=self.correction,
            compiled=self.compiled,
            **options,
        )
        if run.interrupted:
            raise KeyboardInterrupt
        return run

    @property
    def even(self) -> bool:
        """Return whether all steps cost the same.

        Steps that can be rejected, or that iterate, do not.
        """
        return not (self.scheme.adaptive or self.scheme.implicit)

    def instructions(self) -> int:
        """Count the instructions of one step and its correction.

        It is 0 for implicit schemes, which iterate an unknown number of times.
        """
        if self.scheme.implicit:
            return 0
        project = None if self.correction is None else self.correction.step(self.model)
        extra = (
            0
            if self.correction is None or project is None
            else count_instructions(project) / self.correction.every
        )
        return round(count_instructions(self.scheme.advance(self.model)) + extra)

    def seconds_per_step(self, step: float, repeats: int) -> float:
        """Measure the wall time of a step [s].

        It is the median of `repeats` runs that are long enough for the clock and stay near the
        initial state. A run over [0, t_end] with coarse steps is too short to be timed, and all
        steps cost the same.
        """
        fine = 1e-3 * step

        def seconds(steps: int) -> float:
            return (
                self.run(
                    fine,
                    t_end=fine * steps,
                    control=self._choose_control(),
                    energy_balance=False,
                    save_every=steps,
                ).seconds
                / steps
            )

        # A run of 0.02 s is long enough for the clock. The loop takes powers of 2 per call.
        steps = int(np.clip(0.02 / seconds(2048), 2048, 2**18))
        steps = 2 ** int(np.log2(steps))
        return median(seconds(steps) for _ in range(repeats))

    def _choose_control(self) -> ControlInput:
        """Return the control if it is constant, for timed runs."""
        over_time = callable(self.control) or isinstance(self.control, ControlFunction)
        return None if over_time or np.ndim(np.asarray(self.control)) != 1 else self.control


def start_of(model: Model, state: State) -> Array | None:
    """Return the initial state (nx,) of a model.

    `state` can be a function of the model. None means the model's own initial state. Raises
    TypeError, ValueError.
    """
    value = (
        call_user_function(
            "state", state, model, "give a function of a model that returns its start"
        )
        if callable(state)
        else state
    )
    return None if value is None else finite_array("state", value, (model.nx,))


def _measure_rows(
    case: Case, name: str, lengths: Sequence[float], reference: ReferenceSolution, repeats: int
) -> Iterable[TradeoffRow]:
    """Yield a row of the study for each step length.

    The lengths are in s, and the scheme has a name. Errors are those to the `reference`. Times are
    measured in as many runs as `repeats`. The time of a step and the set-up are measured once.
    """
    empty = TradeoffRow(
        case.scheme,
        np.nan,
        case.correction,
        name,
        compiled=case.compiled is not False,
        single=isinstance(case.compiled, Single),
    )
    each = setup = np.nan
    for step in [case.t_end / GRID] if case.scheme.adaptive else lengths:
        began = time.perf_counter()
        empty = replace(empty, step=np.nan if case.scheme.adaptive else step)
        try:
            run, work = case.run(step), case.instructions()
        except (
            TypeError,
            ValueError,
            CompileError,
        ) as error:  # such as Rattle where supports are moved
            yield replace(empty, message=str(error))
            continue
        if np.isnan(setup):
            setup = time.perf_counter() - began - run.seconds
            empty = replace(empty, compiled=run.compiled, setup=setup)
        row = replace(
            empty, instructions=work, steps=run.attempts, success=run.success, message=run.message
        )
        if run.success:
            if case.even:
                each = case.seconds_per_step(lengths[-1], repeats) if np.isnan(each) else each
                seconds = each * run.attempts
            else:
                seconds = median(
                    case.run(step, energy_balance=False).seconds for _ in range(repeats)
                )
            row = replace(
                row,
                seconds=seconds / case.t_end,
                position=distance(end_nodes(case.model, run), reference.nodes),
                bar=float(run.bar_length_error.max()),
                joint=float(run.joint_error.max()),
                energy=float(np.abs(run.energy_error).max()),
            )
        yield row


def _find_reference(
    named: dict[str, Model],
    t_end: float,
    reference: ReferenceSolution | str | None,
    state: State,
    control: ControlInput,
    compiled: bool | None,
    parameters: Any,
) -> ReferenceSolution:
    if isinstance(reference, ReferenceSolution):
        nodes = len(next(iter(named.values())).scene.structure.nodes)
        if len(reference.nodes) != nodes:
            raise ValueError(
                f"reference has {len(reference.nodes)} nodes, the models have {nodes}: give the reference of the same structure"
            )
        if not np.isclose(reference.t_end, t_end, rtol=1e-12):
            raise ValueError(
                f"reference is for t_end = {reference.t_end:g} s and t_end is {t_end:g}: give one of the same time"
            )
        return reference
    if reference is not None and not (isinstance(reference, str) and reference in named):
        raise ValueError(
            f"reference is {format_value(reference)}: give a tenscasadi.ReferenceSolution or the name of a model, {', '.join(map(repr, named))}"
        )
    model = named[next(iter(named)) if reference is None else reference]
    return reference_solution(
        model, t_end, start_of(model, state), control, compiled=compiled, parameters=parameters
    )


def _check_models(named: dict[str, Model], schemes: Any, corrections: Any) -> None:
    if not named:
        raise ValueError("models is empty: give a tenscasadi.Model, or models by name")
    for name, model in named.items():
        instance(
            f"models[{format_value(name)}]" if name else "models",
            model,
            Model,
            "a tenscasadi.Model, or models by name",
        )
    counts = {name: len(model.scene.structure.nodes) for name, model in named.items()}
    if len(set(counts.values())) > 1:
        raise ValueError(
            f"models have scenes of {counts} nodes: give models of one structure, that differ in what is modelled"
        )
    check_ways(schemes, corrections)


def check_ways(schemes: Any, corrections: Any) -> None:
    """Check the sequences of schemes and corrections.

    Raises TypeError or ValueError unless each has at least one entry.
    """
    for i, scheme in enumerate(_check_sequence("schemes", schemes)):
        check_scheme(scheme, f"schemes[{i}]")
    for correction in _check_sequence("corrections", corrections):
        instance(
            "corrections",
            correction,
            (Projection, BarLengthCorrection, type(None)),
            "(None, Projection())",
        )


def _check_sequence(field: str, values: Any) -> Sequence[Any]:
    single = isinstance(values, str) or (isinstance(values, np.ndarray) and values.ndim == 0)
    if single or not isinstance(values, (Sequence, np.ndarray)):
        raise TypeError(f"{field} is {format_value(values)}: give a sequence, such as a list")
    if not len(values):
        raise ValueError(f"{field} is empty: give at least one")
    return list(values)
