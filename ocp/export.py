"""Export of nonlinear programs and predictive controllers as C code."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ocp.control.mpc import Mpc
from ocp.guess.initial_guess import InitialGuess
from ocp.problem.control import control_unit
from ocp.problem.problem import Problem
from ocp.search.methods import program_of
from ocp.transcription.base import Transcription
from tenscasadi.util.casadi_tools import generate_code
from tenscasadi.util.validate import file_path, instance
from tenscasadi.util.whole_file import write_files, write_whole

_CALLING_CONVENTION = (
    "Each function: int name(const casadi_real** arg, casadi_real** res, casadi_int* iw, "
    "casadi_real* w, int mem); name_work returns the sizes:"
)


def export_program(
    problem: Problem,
    transcription: Transcription,
    folder: str | Path,
    guess: InitialGuess | None = None,
) -> list[Path]:
    """Write the nonlinear program of a problem as C code.

    The code requires only the C library.

    Parameters
    ----------
    problem : Problem
        Optimal control problem.
    transcription : MultipleShooting, DirectCollocation, ImplicitMidpoint or Variational
        Transcription of the problem into a nonlinear program.
    folder : str or Path
        Folder of the files, which is created if necessary.
    guess : InverseDynamics, EquilibriumGuess, TrajectoryGuess or Plan, optional
        Initial guess. Default: `InverseDynamics()`.

    Returns
    -------
    list of Path
        `program.c`, `program.h`, `unknowns.csv` and `rows.csv`.

    Raises
    ------
    InfeasibleGoalError
        If no string forces can reach the goals.
    TypeError, ValueError
        If an argument is wrong, or limits and goals contradict each other.
    OSError
        If a file cannot be written.

    Notes
    -----
    The program is: minimize f(w) subject to lower ≤ g(w) ≤ upper and variable bounds of w, all
    scaled. Its functions are `nlp_f`, `nlp_g`, `nlp_grad_f`, `nlp_jac_g` and `nlp_hess_l`, with
    exact sparse derivatives. `nlp_hess_l` is the upper triangle of the Hessian of lam_f f + lam_gᵀ
    g.

    The tables list name, scale and bounds of each entry of w (unknowns.csv) and g (rows.csv).
    Entries times their scale are in physical units. unknowns.csv also has the initial guess.

    The `accuracy` of a transcription is not part of the program, and `program.h` says so. `solve`
    reaches it by repeated solutions with corrected bounds of the defect constraints.

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
    sizes = f"{len(program.w_names)} unknowns (unknowns.csv), {len(program.names)} rows (rows.csv)"
    comment = [
        f"minimize f(w) subject to bounds of g(w) and w: {sizes}, costs = {program.objective!r} f."
    ]
    if transcription.accuracy is not None:
        comment.append(
            f"{type(transcription).__name__}.accuracy is {transcription.accuracy:g} m: "
            "not part of this program, which is the first that ocp.solve solves."
        )
    functions = [*values, *program.parts.derivatives.values()]
    paths = _write_code(target, "program", functions, comment)
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
        *paths,
        _write_table(
            target / "unknowns.csv", ("name", "scale", "lower", "upper", "first"), unknowns
        ),
        _write_table(target / "rows.csv", ("name", "scale", "lower", "upper"), rows),
    ]


def export_mpc(mpc: Mpc, folder: str | Path) -> list[Path]:
    """Write a predictive controller with its solver as C code.

    The code requires only the C library.

    Parameters
    ----------
    mpc : Mpc
        Controller.
    folder : str or Path
        Folder of the files, which is created if necessary.

    Returns
    -------
    list of Path
        `mpc.c` and `mpc.h`.

    Raises
    ------
    TypeError
        If `mpc` is not an `Mpc`.
    OSError
        If a file cannot be written.

    Notes
    -----
    The C function is `decide` (time, state, before) → after, status, see `Mpc.function`; with rate
    limits it has a fourth input. `before` is the result of the previous call, or `MPC_FIRST` in the
    first one. It contains nu × intervals numbers, interval by interval. Apply the first nu numbers of
    `after`, which are within the limits of the control also if status is 1. mpc.h has the sizes,
    the sampling period, and `MPC_FIRST`.

    Optimize the code for its processor, for example by ``cc -O3 -march=native``: the loops of the
    solver are written for vector instructions.

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
    unit = control_unit(mpc.model)
    lines = [
        f"decide (time s, state, before {unit}) -> after {unit}, status: apply the first "
        "MPC_STRINGS of after for MPC_PERIOD s, then give after as the next before.",
        "status: 0, or 1 if no solution was found, as for a state that is NAN.",
        "State: free coordinates of the nodes, node by node, then their velocities. "
        "MPC_FIRST is the first before.",
    ]
    decide = mpc.function(mpc.quadratic_program.generated())
    if "earlier" in decide.name_in():
        lines.append(
            "earlier: state at the last decision, NAN at the first; rate limits start from it."
        )
    constants = [
        f"#define MPC_STATES {mpc.model.nx}",
        f"#define MPC_STRINGS {mpc.model.nu}",
        f"#define MPC_INTERVALS {mpc.intervals}",
        f"#define MPC_PERIOD {mpc.period!r}",
        f"#define MPC_FIRST {{{first}}}",
    ]
    return _write_code(file_path("folder", folder), "mpc", [decide], lines, constants)


def _write_code(
    folder: Path,
    name: str,
    functions: Sequence[ca.Function],
    comment: Sequence[str],
    constants: Sequence[str] = (),
) -> list[Path]:
    """Write CasADi Functions as C code, `name`.c and `name`.h.

    The lines of `comment` in the header describe them; `constants` are its definitions. Returns
    both paths.
    """
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": True})
    for function in functions:
        generator.add(function)
    head = [
        "/*",
        *(f" * {line}" for line in [*comment, _CALLING_CONVENTION]),
        *(f" * {_describe_signature(function)}" for function in functions),
        " */",
        *constants,
        "",
    ]
    files = generate_code(generator, name)
    return write_files(folder, {**files, f"{name}.h": "\n".join(head) + files[f"{name}.h"]})


def _describe_signature(function: ca.Function) -> str:
    """Describe inputs and outputs of a function with their sizes.

    Sparse matrices hold their nonzeros, column by column.
    """

    def join(count: int, name: Any, sparsity: Any) -> str:
        return ", ".join(f"{name(k)}[{sparsity(k).nnz()}]" for k in range(count))

    inputs = join(function.n_in(), function.name_in, function.sparsity_in)
    outputs = join(function.n_out(), function.name_out, function.sparsity_out)
    return f"{function.name()}: {inputs} -> {outputs}"


def _write_table(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(head)
    writer.writerows(
        [name, *(repr(float(value)) for value in np.asarray(numbers))] for name, *numbers in rows
    )
    write_whole(path, text.getvalue())
    return path
