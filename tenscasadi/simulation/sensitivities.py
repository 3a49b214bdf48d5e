"""Exact derivatives of a run's outputs.

They are taken with respect to the initial state, the control or the parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.simulation.inputs.controls import ControlInput, ControlProfile
from tenscasadi.simulation.inputs.run_inputs import RunInputs, read_inputs
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.tangent_loop import (
    CHUNK,
    TangentSteps,
    choose_width,
    gradient_function,
    tangent_function,
)
from tenscasadi.simulation.tangent_passes import PassSetup, run_adjoint, run_forward
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.names import name_errors
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.compile import CompileError, compile_function
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import (
    TOLERANCE,
    Array,
    Indices,
    call_user_function,
    choice,
    finite_array,
    format_value,
    instance,
)

By = Literal["state", "control", "parameters"]
Mode = Literal["forward", "adjoint"]
Output = ca.Function | Callable[[Any, Any], Any] | None


@dataclass(frozen=True, eq=False)
class Sensitivities(ReadOnlyArrays):
    """Derivatives of the outputs of a run.

    `sensitivities` returns them. Arrays are read-only.

    Attributes
    ----------
    value : ndarray, shape (m,)
        The output.
    jacobian : ndarray, shape (m, nx), (m, K, nu) or (m, np)
        Its derivatives with respect to the start, the control in each of K intervals, or the
        parameters; NaN if the run did not reach its end.
    state : ndarray, shape (nx,)
        State at the end of the run.
    mode : {"forward", "adjoint"}
        Mode of differentiation.
    success : bool
        Whether the run is trustworthy, see `Trajectory`, and the derivatives are finite.
    message : str
        End of the run, and reasons not to trust it.
    seconds : float
        Wall time of the derivatives [s], without compilation.
    compiled : bool
        Whether they were computed by machine code.

    See Also
    --------
    sensitivities : Compute them.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> tc.sensitivities(model, t_end=0.1, step=0.01, compiled=False)
    Sensitivities(6 outputs by 6 inputs, forward, success=True)
    """

    value: Array
    jacobian: Array
    state: Array
    mode: str
    success: bool
    message: str
    seconds: float
    compiled: bool

    def __repr__(self) -> str:
        inputs = int(np.prod(self.jacobian.shape[1:]))
        return f"Sensitivities({len(self.value)} outputs by {inputs} inputs, {self.mode}, success={self.success})"


@rename_keywords(of="output")
@name_errors
def sensitivities(  # noqa: PLR0913  options of the run and of the derivatives
    model: Model,
    start: Any = None,
    t_end: float | None = None,
    step: float | None = None,
    scheme: Scheme = RungeKutta4(),
    control: ControlInput = None,
    correction: Correction | None = None,
    *,
    output: Output = None,
    over: Literal["end", "run"] = "end",
    by: By = "state",
    parameters: Any = None,
    mode: Mode | None = None,
    compiled: bool | None = None,
) -> Sensitivities:
    """Compute exact derivatives of the outputs of a run.

    They are taken with respect to the start, the control or the parameters.

    Parameters
    ----------
    model : Model
        The model.
    start : array_like, shape (nx,), or Trajectory, optional
        State at the start, or a run of `simulate`, which gives start, end, step, control and
        parameters. Default: `model.initial_state`.
    t_end : float, optional
        End of the run [s]; required unless `start` is a trajectory.
    step : float, optional
        Largest step [s]. Default: 1 ms, or less if stability or contact requires it.
    scheme : Scheme, optional
        Integration scheme with steps of fixed size, such as `RungeKutta4` (default), `Rattle` or
        `Collocation`; of a trajectory: its own.
    control : array_like or callable, optional
        Control, as for `simulate`.
    correction : Projection or BarLengthCorrection, optional
        Correction after every `correction.every`-th step; of a trajectory: its own.
    output : casadi.Function or callable, optional
        Output (m,): a Function (x), (x, u) or (x, u, p), or a Python function of these CasADi
        columns that returns an expression. They are x (nx), u (nu), and p (np) if the model has
        parameters. Default: the state.
    over : {"end", "run"}
        "end": the output at the end of the run. "run": its integral over time by the scheme, m = 1.
    by : {"state", "control", "parameters"}
        "state" is the initial state. "control" is the control in each interval of a table, or a
        control added in each step to a function of time. "parameters" are those of the model, with
        the same start and control.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, as for `simulate`. Default: nominal.
    mode : {"forward", "adjoint"}, optional
        "forward" computes a tangent for each input, "adjoint" a gradient for each output. Default:
        the cheaper one.
    compiled : bool, optional
        As for `simulate`.

    Returns
    -------
    Sensitivities
        Value and derivatives. If the run diverges, they are NaN, `success` is False and `message`
        gives the reason.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or a trajectory has other steps; the message names it.
    CompileError
        `compiled` is True and compilation fails.

    See Also
    --------
    linearize : Derivatives of the right-hand side.

    Notes
    -----
    The derivatives are those of the discrete steps, correct to rounding. Finite differences of the
    same run converge to them. At an event within a step, each stage uses the derivative of its own
    mode. The time of the event is not resolved, so the derivatives depend discontinuously on the
    steps. Near impacts they may differ strongly from the derivative of the exact solution. `Smooth`
    strings and smaller steps reduce the difference. Derivatives of chaotic motions grow without
    bound.

    Derivatives with respect to the start cover all directions of the state, including those that
    stretch bars. Only changes that satisfy the constraints are possible. Derivatives with respect
    to the clock keep the steps fixed, including those that end at breakpoints of loads.

    Machine code takes 256 steps per call. Only the states between calls are stored, and the adjoint
    pass computes the others again, so memory hardly grows with the steps. A tangent costs as much
    as two runs of `RungeKutta4` or two to five of `Rattle`. A gradient costs three to six runs for
    all inputs at once. `Collocation` is differentiated as the solution of its equations, by a
    solver that takes several times as long as the scheme's own.

    References
    ----------
    .. [1] E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section
    I.14.

    Examples
    --------
    Release a pendulum of 1 m at 45°. Its position after one second depends on an initial velocity
    along its arc, (1, 0, 1) m/s:

    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> found = tc.sensitivities(model, t_end=1.0, step=0.01, output=lambda x, u: model.nodes(x)[1, 0], compiled=False)
    >>> found.mode, found.jacobian.shape
    ('adjoint', (1, 6))
    >>> round(float(found.jacobian[0] @ [0, 0, 0, 1, 0, 1]), 4)
    -0.1576
    """
    request = _read(model, start, t_end, step, control, parameters)
    _check(model, scheme, over, by, mode, compiled)
    observed = _read_output(model, output)
    if over == "run" and observed.size1_out(0) != 1:
        raise ValueError(f'output has {observed.size1_out(0)} entries: give one for over="run"')
    run = simulate(
        model, state=request.start, control=request.control, t_end=request.t_end, step=request.step, scheme=scheme,
        correction=correction, save_every=CHUNK, energy_balance=False, verify=False, compiled=compiled, parameters=request.parameters,
    )  # fmt: skip
    task, observed = _prepare_pass(model, request, run, scheme, correction, observed, over, by)
    rows, columns = observed.size1_out(0), int(np.prod(task.shape))
    # A gradient costs about as much as two tangents.
    chosen = mode or ("forward" if columns <= 2.0 * rows else "adjoint")
    if run.time[-1] < request.t_end * (1 - 1e-9) or run.breaks:
        unknown = np.full(rows, np.nan), np.full((rows, *task.shape), np.nan)
        message = run.message
        if run.breaks:
            message += ": derivatives across a break are not computed, give a smaller t_end"
        found = Sensitivities(*unknown, run.states[-1].copy(), chosen, False, message, 0.0, False)
    else:
        _compare(request, run)
        found = _differentiate(task, observed, run, chosen, compiled)
    if by == "control":
        return found
    inside = found.jacobian[:, : model.nx] if by == "state" else found.jacobian[:, 0]
    return replace(found, jacobian=inside)  # without the clock of a control function


def _prepare_pass(
    model: Model,
    request: _RunArguments,
    run: Trajectory,
    scheme: Scheme,
    correction: Correction | None,
    observed: ca.Function,
    over: str,
    by: str,
) -> tuple[PassSetup, ca.Function]:
    """Prepare the derivatives of a run, and the output function.

    `request` contains the arguments of the run. `observed` is the output, a Function (x, w). If
    `over` is "run", it is integrated over time. The derivatives are with respect to the initial
    state, the control or the parameters: `by` is "state", "control" or "parameters". The output
    includes a control that is a function of time. The `correction` restores constraints between
    steps.
    """
    inputs = read_inputs(
        model,
        request.t_end,
        request.step,
        scheme,
        request.start,
        request.control,
        request.parameters,
        many=False,
    )
    observed = inputs.include_schedule(observed)
    steps = TangentSteps(inputs.model, scheme, correction, observed if over == "run" else None)
    control = by == "control"
    owner = _owners(request.control, inputs) if control else np.zeros(inputs.grid.steps, np.intp)
    entries = {
        "state": None,
        "control": slice(0, model.nu),
        "parameters": slice(model.nu, model.nw),
    }[by]
    states = inputs.append_clock(run.time, run.states)
    return PassSetup(steps, states, inputs, owner, entries), observed


class _RunArguments(NamedTuple):
    """Arguments of the run that is differentiated.

    They are those of `simulate`, with the initial state `start` (nx,). `last` is the final state of
    a given trajectory, else None.
    """

    start: Array
    t_end: float
    step: float | None
    control: ControlInput | ControlProfile
    parameters: Array
    last: Array | None


# --- arguments ---


def _read(
    model: Any, start: Any, t_end: Any, step: Any, control: Any, parameters: Any
) -> _RunArguments:
    check_model(model)
    if not isinstance(start, Trajectory):
        if t_end is None:
            raise ValueError("t_end is None: give the end of the run, s, or a trajectory as start")
        p = model.parameters.values(parameters)
        state = model.start_at(p) if start is None else finite_array("start", start, (model.nx,))
        return _RunArguments(np.array(state), t_end, step, control, p, None)
    for name, value in {
        "t_end": t_end,
        "step": step,
        "control": control,
        "parameters": parameters,
    }.items():
        if value is not None:
            raise ValueError(
                f"{name} is {format_value(value)}, and start is a trajectory, which provides it: leave one out"
            )
    if (
        not len(start.time) > 1
        or start.states.shape[1] != model.nx
        or start.control.shape[1] != model.nu
        or len(start.parameters) != model.np
    ):
        raise ValueError(
            f"start is {start!r}, with states of {start.states.shape[1]}: give a run of this model, with states of {model.nx}"
        )
    if not start.success:
        raise ValueError(f"start is a run that failed ({start.message}): give one that succeeded")
    held = start.control[:-1]
    constant = not held.size or bool(np.all(held == held[0]))
    given: Any = held[0] if constant else ControlProfile(np.asarray(start.time), held)
    return _RunArguments(
        np.array(start.states[0]),
        float(start.time[-1]),
        float(start.step),
        given,
        np.array(start.parameters),
        start.states[-1],
    )


def _check(model: Model, scheme: Any, over: Any, by: Any, mode: Any, compiled: Any) -> None:
    choice("over", over, "end", "run")
    choice("by", by, "state", "control", "parameters")
    if mode is not None:
        choice("mode", mode, "forward", "adjoint")
    double = "True, False or None, as derivatives are of double precision"
    instance("compiled", compiled, (bool, np.bool_, type(None)), double)
    if getattr(scheme, "adaptive", False) or isinstance(scheme, Sundials):
        raise ValueError(
            f"scheme is {format_value(scheme)}, which chooses its steps: give one with fixed steps, such as RungeKutta4() or Rattle()"
        )
    if by == "control" and not model.nu:
        raise ValueError(
            'by is "control", and the scene has none: give Scene(control=ForceDensity()) or RestLength(), or by="state"'
        )
    if by == "parameters" and not model.np:
        raise ValueError(
            'by is "parameters", and the scene has none: give Scene(parameters=Parameters(...)), or by="state"'
        )


def _read_output(model: Model, output: Any) -> ca.Function:
    """Build the output Function (x, w) → dense column.

    Raises TypeError, ValueError.
    """
    sizes = [model.nx, model.nu, *([model.np] if model.np else [])]
    x, w = ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nw)
    arguments = [x, w[: model.nu], w[model.nu :]][: len(sizes)]
    wanted = (
        f"give a casadi.Function of {' and '.join(map(str, sizes))} entries or the first of them, "
        "or a function that returns an expression of them"
    )
    if output is None:
        value: Any = x
    elif isinstance(output, ca.Function):
        if (
            output.n_out() != 1
            or not output.n_in()
            or [output.size_in(k) for k in range(output.n_in())]
            != [(size, 1) for size in sizes[: output.n_in()]]
        ):
            raise ValueError(f"output is {output}: {wanted}")
        value = output(*arguments[: output.n_in()])
    elif callable(output):
        value = call_user_function("output", lambda given: output(*given), arguments, wanted)
    else:
        raise TypeError(f"output is {format_value(output)}: {wanted}")
    try:
        return ca.Function("output", [x, w], [ca.vec(ca.densify(ca.MX(value)))])
    except (RuntimeError, NotImplementedError, TypeError):
        raise TypeError(f"output returns {format_value(value)}: {wanted}") from None


def _owners(control: Any, inputs: RunInputs) -> Indices:
    """Find the control interval (steps,) to which each step belongs.

    The interval is that of a table or a profile, or the step itself. `inputs` contain the time
    grid.
    """
    grid = inputs.grid
    steps = np.arange(grid.steps)
    if isinstance(control, ControlProfile) and len(control.values) == len(control.time):
        raise ValueError(
            "control.values is linear between its times: give one row for each interval, or a table"
        )
    if inputs.model.schedule is not None:
        return steps
    return np.asarray(grid.rows[grid.locate(steps)])


def _compare(request: _RunArguments, run: Trajectory) -> None:
    if request.last is None:
        return
    off = float(np.abs(run.states[-1] - request.last).max(initial=0.0))
    if off > TOLERANCE * max(1.0, float(np.abs(request.last).max(initial=0.0))):
        raise ValueError(
            f"start is a trajectory whose last state is {off:.2g} from where these steps end: give the scheme, the correction and, where it "
            "changes between the rows kept, the control of that run with its first state"
        )


# --- passes over the run ---


def _differentiate(
    task: PassSetup, output: ca.Function, run: Trajectory, mode: Mode, compiled: bool | None
) -> Sensitivities:
    steps, model = task.steps, task.steps.model
    symbols = output.mx_in()
    slopes = [ca.densify(ca.jacobian(output(*symbols), symbol)) for symbol in symbols]
    at_end = ca.Function("at_end", symbols, [output(*symbols), *slopes])(
        task.states[-1], task.inputs.stack(0, np.array([task.inputs.grid.steps - 1]))[0]
    )
    value, by_z, by_w = (result.full() for result in at_end)
    if steps.running is not None:  # the output is the last entry of z
        by_z, by_w = np.eye(1, steps.size, model.nx), np.zeros_like(by_w)
    forward = mode == "forward"
    width = choose_width(model, int(np.prod(task.shape)) if forward else len(by_z))
    function, is_code, note = _loop(task, forward, width, compiled)
    began = time.perf_counter()
    with np.errstate(all="ignore"):  # the message reports an overflow
        found = (run_forward if forward else run_adjoint)(
            task, ArrayFunction(function), width, by_z
        )
    jacobian = found.jacobian
    if task.entries is not None:
        jacobian[:, task.owner[-1]] += by_w[:, task.entries]
    seconds = time.perf_counter() - began
    message, finite = run.message + note, bool(np.all(np.isfinite(jacobian)))
    same = found.apart <= TOLERANCE * max(1.0, float(np.abs(run.states).max(initial=0.0)))
    if not finite:
        message += "; the derivatives are not finite: they overflow, or a step is not differentiable where it was taken"
    elif not same:
        message += f"; the steps that were differentiated end {found.apart:.2g} from those of the run: try a smaller step"
    value = value.ravel() if steps.running is None else np.array([found.integral])
    return Sensitivities(
        value,
        jacobian,
        run.states[-1].copy(),
        mode,
        run.success and finite and same,
        message,
        seconds,
        is_code,
    )


def _loop(
    task: PassSetup, forward: bool, width: int, compiled: bool | None
) -> tuple[ca.Function, bool, str]:
    """Build the Function of a tangent or adjoint pass.

    With `forward`, it is a tangent pass. It propagates `width` directions at a time. The model
    caches the Function. `compiled` is whether machine code is required, with None for a choice.
    Also returns whether it is machine code, and the reason if it should be but is not, else "".
    """
    steps, held = task.steps, task.entries is None
    known, key = steps.model.functions, ("derivatives", *steps[1:], forward, width, held, compiled)
    if steps.running is None and isinstance(steps.scheme, Hashable) and key in known:
        return known[key], "External" in known[key].class_name(), ""
    function = tangent_function(steps, width, held) if forward else gradient_function(steps, width)
    note = ""
    if compiled is None or compiled:
        try:
            function = compile_function(function)
        except CompileError as error:
            if compiled:
                raise
            note = f"; derivatives not compiled: {str(error).splitlines()[0]}"
    if steps.running is None and isinstance(steps.scheme, Hashable):
        known[key] = function
    return function, "External" in function.class_name(), note
