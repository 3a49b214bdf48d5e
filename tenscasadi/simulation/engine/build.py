"""Construction of a model's time loop, which the model caches."""

from __future__ import annotations

import os
from collections.abc import Hashable
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.events import count_breakable
from tenscasadi.integrators.runge_kutta import EmbeddedRungeKutta
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.simulation.engine.interpreted import Interpreted
from tenscasadi.simulation.engine.kernel import Kernel, SchemeNumbers
from tenscasadi.simulation.engine.native import NativeCode, compile_first
from tenscasadi.simulation.engine.step_code import Account, Measured, write_program
from tenscasadi.simulation.engine.sundials_runs import SundialsRuns
from tenscasadi.util.compile import Compiled, CompileError, Single, find_compiler


class _Options(NamedTuple):
    scheme: Any
    correction: Correction | None
    stage: ca.Function | None
    final: ca.Function | None
    measured: Measured
    account: Account
    lanes: int | None
    compiled: Compiled
    lazily: bool
    companions: bool


def build_kernel(
    model: Model,
    scheme: Scheme,
    correction: Correction | None = None,
    stage: ca.Function | None = None,
    final: ca.Function | None = None,
    *,
    measured: bool | Measured = False,
    account: Account | None = None,
    lanes: int | None = None,
    compiled: Compiled = None,
    lazily: bool = False,
    companions: bool = False,
) -> Kernel:
    """Build the time loop (kernel) of a model.

    The model caches it.

    Parameters
    ----------
    model : Model
        Model of all runs.
    scheme : Scheme
        Integration scheme.
    correction : Projection or BarLengthCorrection, optional
        Applied after every `correction.every`-th step.
    stage, final : casadi.Function, optional
        Stage cost, evaluated at the end of each interval and multiplied by its length, and
        terminal cost: Functions (x, w) → (1) with w = [u; p]. Their w, and then the inputs, may
        have further entries for the costs alone, such as the time.
    measured : bool or {"nothing", "errors", "all"}
        Measure errors of bars and joints, and energies; "all" adds force densities and tensions.
    account : Account, optional
        Energies to integrate. Default: all of them if something is measured.
    lanes : int, optional
        Runs per instruction. Default: as many as the registers hold; 1 for schemes whose steps
        differ between runs.
    compiled : bool or Single, optional
        True: machine code. False: CasADi. None: machine code if there is a compiler.
    lazily : bool
        Whether to begin without machine code and compile once this saves wall time, if `compiled`
        is None.
    companions : bool
        Whether SIMD lanes also compute one run with longer steps, if the scheme allows it.

    Returns
    -------
    Kernel
        Integrator to call with states and inputs.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong.
    CompileError
        `compiled` is True and compilation fails.
    """
    check_scheme(scheme)
    kind: Measured = (
        ("errors" if measured else "nothing") if isinstance(measured, bool) else measured
    )
    if account is None:
        account = Account(kind != "nothing", kind != "nothing" and model.nu > 0)
    branches = scheme.adaptive or scheme.implicit or count_breakable(model) > 0
    width = 1 if branches else lanes
    options = _Options(
        scheme,
        correction,
        stage,
        final,
        kind,
        account,
        width,
        compiled,
        lazily and compiled is None,
        companions
        and width == 1
        and not branches
        and not isinstance(compiled, Single)
        and (correction is None or correction.every == 1),
    )
    if not isinstance(scheme, Hashable):  # user-defined scheme
        return _build(model, options)
    place = os.environ.get("CC"), os.environ.get("PATH")  # of the compiler
    return model.keep(("kernel", *options, *place), lambda: _build(model, options))


def _build(model: Model, options: _Options) -> Kernel:
    scheme, correction, compiled = options.scheme, options.correction, options.compiled
    every = 1 if correction is None else correction.every
    if isinstance(scheme, Sundials):
        if compiled:
            raise CompileError(
                f"{type(scheme).__name__} is an integrator of SUNDIALS, which makes no C code: give compiled=None or another scheme"
            )
        backend = SundialsRuns(model, scheme, correction, options.account, options.measured)
        return Kernel(backend.program, SchemeNumbers(np.zeros(1), 0, 0), backend)
    if scheme.adaptive and every != 1:
        raise ValueError(
            f"correction.every is {every}: {type(scheme).__name__} with rtol corrects after each of its own steps, give every=1"
        )
    if isinstance(compiled, Single):
        check_single(scheme)
    numbers = SchemeNumbers(np.zeros(1), 0, every)
    if isinstance(scheme, EmbeddedRungeKutta) and scheme.adaptive:
        tolerances = np.array([0.0, *scheme.tolerances(model)])
        numbers = SchemeNumbers(tolerances, scheme.max_attempts, every)
    elif isinstance(scheme, Collocation):
        numbers = SchemeNumbers(np.full(1, scheme.tolerance), 0, every)
        scheme = replace(scheme, tolerance=Collocation.tolerance)
    costs = options.stage, options.final
    program = write_program(model, scheme, correction, options.account, options.measured, costs)
    if compiled is False:
        return Kernel(program, numbers, Interpreted(program))
    single = isinstance(compiled, Single)
    codes = [NativeCode(program, width, single) for width in dict.fromkeys((options.lanes, 1))]
    if options.companions and program.tableau and program.functions["ode"].is_a("SXFunction"):
        codes.insert(0, NativeCode(program, 1, companions=True))  # lanes of loops compile slowly
    if options.lazily:
        native, note = compile_first(codes[:1], build=False)
        if native is None and find_compiler() is not None:
            return Kernel(program, numbers, Interpreted(program), codes=codes)
    else:
        native, note = compile_first(codes)
    if native is None and compiled:
        raise CompileError(note)
    return Kernel(program, numbers, native or Interpreted(program), note)


def check_single(scheme: Scheme) -> None:
    """Check that a scheme's tolerances are possible in single precision.

    Raises ValueError otherwise.
    """
    least = 1e-6  # about ten times the rounding error of float, as 1e-15 of double
    for name in ("rtol", "tolerance"):
        given = getattr(scheme, name, None)
        if given is not None and given < least:
            raise ValueError(
                f"{type(scheme).__name__}.{name} is {given:g}: give {least:g} or more in single precision, less is rounding"
            )
