"""Equations of motion as functions of JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import MAX_COUNT, instance


class _Instruction(NamedTuple):
    """Instruction of a CasADi function.

    It has the operation, the places of its result and operands, and a constant.
    """

    operation: int
    result: int
    operands: tuple[int, ...]
    constant: float


def to_jax(model: Model) -> Callable[..., Any]:
    """Convert the equations of motion into a JAX function.

    The function takes the inputs of `Model.ode`, arrays x (nx,) and u (nu,), and p (np,) if the
    model has parameters, and returns ẋ (nx,). It can be transformed by ``jax.jit``, ``jax.vmap``
    and ``jax.grad``.

    Parameters
    ----------
    model : Model
        Model in reduced coordinates, of up to about 100 members.

    Returns
    -------
    callable
        Function of JAX arrays.

    Raises
    ------
    ImportError
        If JAX is not installed: ``pip install 'tenscasadi[jax]'``.
    TypeError, ValueError
        The model is no `Model`, solves sparse systems in its equations, or is too large.

    Notes
    -----
    JAX computes in single precision unless ``jax.config.update("jax_enable_x64", True)`` is called
    before. In double precision the function equals `Model.ode` to rounding.

    Examples
    --------
    >>> import jax
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> ode = jax.jit(tc.to_jax(model))
    >>> ode(model.initial_state, model.initial_control).shape
    (36,)
    """
    instance("model", model, Model, "a tenscasadi.Model")
    try:
        import jax.numpy as jnp
    except ImportError as error:
        raise ImportError("to_jax requires JAX: pip install 'tenscasadi[jax]'") from error
    function, operations = _expand(model), _list_operations(jnp)
    program = [_read_instruction(function, k) for k in range(function.n_instructions())]
    handled = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *operations}
    if unknown := {step.operation for step in program} - handled:
        raise ValueError(f"model has the CasADi operations {sorted(unknown)}, unknown here")
    rows, sizes = function.sparsity_out(0).row(), [*map(function.numel_in, range(function.n_in()))]

    def ode(*inputs: Any) -> Any:
        if len(inputs) != len(sizes):
            names = ", ".join(function.name_in())
            raise TypeError(f"the function got {len(inputs)} arrays: give {names}")
        arrays = [jnp.reshape(jnp.asarray(a), (n,)) for a, n in zip(inputs, sizes, strict=True)]
        out = _run(program, arrays, operations)
        values = [out.get(k, 0.0) for k in range(len(rows))]
        placed = dict(zip(rows, values, strict=True))
        return jnp.stack([jnp.asarray(placed.get(k, 0.0), float) for k in range(model.nx)])

    return ode


def _expand(model: Model) -> ca.Function:
    """Expand the equations of motion to scalar operations.

    Raises ValueError.
    """
    try:
        function = model.ode.expand()
    except RuntimeError as error:
        cure = 'give Model(scene, coordinates="reduced")'
        raise ValueError(f"model solves sparse systems, which JAX lacks: {cure}") from error
    count = function.n_instructions()
    if count > MAX_COUNT:  # XLA compiles about 10 000 in a minute
        raise ValueError(f"model has {count} operations: give one of at most {MAX_COUNT}")
    return function


def _run(
    program: list[_Instruction],
    arrays: list[Any],
    operations: dict[int, Callable[..., Any]],
) -> dict[int, Any]:
    """Execute CasADi instructions on JAX arrays.

    `arrays` are the nonzeros of the inputs, and `operations` the JAX functions by operation code.
    Returns the nonzeros of the output by their indices.
    """
    work: dict[int, Any] = {}
    out: dict[int, Any] = {}
    for step in program:
        if step.operation == ca.OP_INPUT:
            work[step.result] = arrays[step.operands[0]][step.operands[1]]
        elif step.operation == ca.OP_CONST:
            work[step.result] = step.constant
        elif step.operation == ca.OP_OUTPUT:
            out[step.operands[1]] = work[step.operands[0]]
        else:
            given = (work[k] for k in step.operands)
            work[step.result] = operations[step.operation](*given)
    return out


def _read_instruction(function: ca.Function, k: int) -> _Instruction:
    operation = function.instruction_id(k)
    operands, results = function.instruction_input(k), function.instruction_output(k)
    if operation == ca.OP_OUTPUT:  # its results are the output and the place of the nonzero there
        return _Instruction(operation, -1, (operands[0], results[1]), 0.0)
    constant = function.instruction_constant(k) if operation == ca.OP_CONST else 0.0
    return _Instruction(operation, results[0], tuple(operands), constant)


def _list_operations(jnp: Any) -> dict[int, Callable[..., Any]]:
    """Return the JAX functions for CasADi's operation codes.

    The result is keyed by operation code. `jnp` is the module `jax.numpy`.
    """
    same = "sin cos tan exp log sqrt floor ceil sinh cosh tanh expm1 log1p hypot sign"
    table = {getattr(ca, f"OP_{name.upper()}"): getattr(jnp, name) for name in same.split()}
    for name in ("asin", "acos", "atan", "asinh", "acosh", "atanh"):
        table[getattr(ca, f"OP_{name.upper()}")] = getattr(jnp, f"arc{name[1:]}")
    return table | {
        ca.OP_ASSIGN: lambda a: a,
        ca.OP_ADD: lambda a, b: a + b,
        ca.OP_SUB: lambda a, b: a - b,
        ca.OP_MUL: lambda a, b: a * b,
        ca.OP_DIV: lambda a, b: a / b,
        ca.OP_NEG: lambda a: -a,
        ca.OP_POW: jnp.power,
        ca.OP_CONSTPOW: jnp.power,
        ca.OP_SQ: lambda a: a * a,
        ca.OP_TWICE: lambda a: 2.0 * a,
        ca.OP_INV: lambda a: 1.0 / a,
        ca.OP_LT: lambda a, b: jnp.where(a < b, 1.0, 0.0),
        ca.OP_LE: lambda a, b: jnp.where(a <= b, 1.0, 0.0),
        ca.OP_EQ: lambda a, b: jnp.where(a == b, 1.0, 0.0),
        ca.OP_NE: lambda a, b: jnp.where(a != b, 1.0, 0.0),
        ca.OP_NOT: lambda a: jnp.where(a == 0, 1.0, 0.0),
        ca.OP_AND: lambda a, b: jnp.where((a != 0) & (b != 0), 1.0, 0.0),
        ca.OP_OR: lambda a, b: jnp.where((a != 0) | (b != 0), 1.0, 0.0),
        ca.OP_IF_ELSE_ZERO: lambda a, b: jnp.where(a != 0, b, 0.0),
        ca.OP_FABS: jnp.abs,
        ca.OP_FMIN: jnp.minimum,
        ca.OP_FMAX: jnp.maximum,
        ca.OP_FMOD: jnp.fmod,
        ca.OP_COPYSIGN: jnp.copysign,
        ca.OP_ATAN2: jnp.arctan2,
    }
