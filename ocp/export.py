"""Programs and controllers as C that needs nothing but the C library."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ocp.control.mpc import Mpc
from ocp.problem.problem import Problem
from ocp.search.methods import program_of
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import InitialGuess
from tenscasadi.util.casadi_tools import generated
from tenscasadi.util.validate import file_path, instance
from tenscasadi.util.whole_file import write_files, write_whole


def export_program(
    problem: Problem,
    transcription: Transcription,
    folder: str | Path,
    guess: InitialGuess | None = None,
) -> list[Path]:
    """Write the nonlinear program of a plan as C that needs nothing but the C library.

    Parameters
    ----------
    problem : Problem
        What is asked.
    transcription : MultipleShooting, Collocation, ImplicitMidpoint or Variational
        How the motion becomes a program.
    folder : str or Path
        Where the files go; made if need be.
    guess : InverseDynamics, Equilibrium, Arrays or Plan, optional
        Where solvers start. Default: `InverseDynamics()`.

    Returns
    -------
    list of Path
        `program.c`, `program.h`, `unknowns.csv` and `rows.csv`.

    Raises
    ------
    InfeasibleGoalError
        No strings can bring the goals about.
    TypeError, ValueError
        An argument is wrong, or limits and goals contradict each other.
    OSError
        A file cannot be written.

    Notes
    -----
    The program: minimise f(w) subject to lower ≤ g(w) ≤ upper and limits of w, all scaled. Its
    functions are `nlp_f`, `nlp_g`, `nlp_grad_f`, `nlp_jac_g` and `nlp_hess_l` (the upper triangle
    of the Hessian of lam_f f + lam_gᵀ g), with exact sparse derivatives. The tables say what each
    entry of w and g is, its limits, and its scale, by which it is multiplied for physical units;
    unknowns.csv also where to start.

    An `accuracy` of the transcription is no part of it, which `program.h` says: `solve` gets there
    by solving the program several times, with other limits of the rows of the motion.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(cross, goals=[ocp.AtRest()], costs=[ocp.Effort()])
    >>> [path.name for path in ocp.export_program(problem, ocp.MultipleShooting(5), mkdtemp())]
    ['program.c', 'program.h', 'unknowns.csv', 'rows.csv']
    """
    target = file_path("folder", folder)
    program = program_of(problem, transcription, guess)
    w = program.problem["x"]
    p = ca.MX.sym("p", 0)
    values = [
        ca.Function(f"nlp_{name}", [w, p], [program.problem[name]], ["x", "p"], [name])
        for name in "fg"
    ]
    sizes = f"{len(program.w_names)} unknowns (unknowns.csv), {len(program.names)} rows (rows.csv), costs = {program.objective!r} f"
    comment = [f"minimise f(w) subject to limits of g(w) and w: {sizes}."]
    if transcription.accuracy is not None:
        comment.append(
            f"{type(transcription).__name__}.accuracy is {transcription.accuracy:g} m, and no part of it: this is what is solved first."
        )
    written = _generate(target, "program", [*values, *program.parts.derivatives.values()], comment)
    unknowns = zip(
        program.w_names,
        program.w_scale,
        program.w_lower,
        program.w_upper,
        program.first,
        strict=True,
    )
    rows = zip(program.names, program.scale, program.lower, program.upper, strict=True)
    return [
        *written,
        _table(target / "unknowns.csv", ("name", "scale", "lower", "upper", "first"), unknowns),
        _table(target / "rows.csv", ("name", "scale", "lower", "upper"), rows),
    ]


def export_mpc(mpc: Mpc, folder: str | Path) -> list[Path]:
    """Write a predictive controller, with its solver, as C that needs nothing but the C library.

    Parameters
    ----------
    mpc : Mpc
        The controller.
    folder : str or Path
        Where the files go; made if need be.

    Returns
    -------
    list of Path
        `mpc.c` and `mpc.h`.

    Raises
    ------
    TypeError
        It is no `Mpc`.
    OSError
        A file cannot be written.

    Notes
    -----
    The function is `decide` (time, state, before) → after, as `Mpc.function` describes it, also
    where it has a fourth input. before and after are α × intervals numbers, interval by interval;
    the first α of `after` are to be applied. mpc.h holds the sizes, the period, and `MPC_FIRST` to
    begin with.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> controller = ocp.Mpc(ocp.Problem(cross, goals=[ocp.AtRest()]), period=0.1, intervals=2)
    >>> [path.name for path in ocp.export_mpc(controller, mkdtemp())]
    ['mpc.c', 'mpc.h']
    """
    instance("mpc", mpc, Mpc, "an ocp.Mpc")
    first = ", ".join(repr(float(value)) for value in mpc.first.T.ravel())
    lines = [
        "decide (time s, state, before N/m) -> after N/m; apply the first MPC_STRINGS of after for MPC_PERIOD s, then hand it on as before.",
        "State: free coordinates of the nodes, node by node, then their velocities. MPC_FIRST is the first before.",
    ]
    decide = mpc.function()
    if "earlier" in decide.name_in():
        lines.append(
            "earlier: the state at the last decision, NAN to begin with; limits of rates hold from there on."
        )
    constants = [
        f"#define MPC_STATES {mpc.model.nx}",
        f"#define MPC_STRINGS {mpc.model.nu}",
        f"#define MPC_INTERVALS {mpc.intervals}",
        f"#define MPC_PERIOD {mpc.period!r}",
        f"#define MPC_FIRST {{{first}}}",
    ]
    return _generate(file_path("folder", folder), "mpc", [decide], lines, constants)


def _generate(
    folder: Path,
    name: str,
    functions: Sequence[ca.Function],
    comment: Sequence[str],
    constants: Sequence[str] = (),
) -> list[Path]:
    """`name`.c and `name`.h, whose head says what they are."""
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": True})
    for function in functions:
        generator.add(function)
    head = [
        "/*",
        *(f" * {line}" for line in [*comment, CALL]),
        *(f" * {_signature(function)}" for function in functions),
        " */",
        *constants,
        "",
    ]
    files = generated(generator, name)
    return write_files(folder, {**files, f"{name}.h": "\n".join(head) + files[f"{name}.h"]})


CALL = "Each function: int name(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem); name_work tells sizes:"


def _signature(function: ca.Function) -> str:
    """Describe inputs and outputs of a function with their sizes; matrices that are sparse hold their non-zeros, column by column."""

    def listed(count: int, name: Any, sparsity: Any) -> str:
        return ", ".join(f"{name(k)}[{sparsity(k).nnz()}]" for k in range(count))

    before = listed(function.n_in(), function.name_in, function.sparsity_in)
    return f"{function.name()}: {before} -> {listed(function.n_out(), function.name_out, function.sparsity_out)}"


def _table(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(head)
    writer.writerows(
        [name, *(repr(float(value)) for value in np.asarray(numbers))] for name, *numbers in rows
    )
    write_whole(path, text.getvalue())
    return path
