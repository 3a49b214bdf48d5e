"""Export of a model as C without dependencies.

The code contains the equations, their derivatives, one step, and a program that runs them. It needs
only the C library.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.breaks import split_at_breaks
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import Projection, correct
from tenscasadi.scene.samples import reject_python_functions
from tenscasadi.simulation.engine.build import check_single
from tenscasadi.util.casadi_tools import generate_code
from tenscasadi.util.compile import Single
from tenscasadi.util.validate import Array, file_path, instance, positive_number
from tenscasadi.util.whole_file import write_files


def export_c(
    model: Model,
    folder: str | Path,
    scheme: Scheme = RungeKutta4(),
    precision: Single | None = None,
    parameters: Any = None,
    *,
    t_end: float | None = None,
) -> list[Path]:
    """Export a model as C without dependencies.

    The code needs only the C library.

    Parameters
    ----------
    model : Model
        The model to write.
    folder : str or Path
        Folder for the files; it is created if necessary.
    scheme : Scheme, optional
        Integration scheme of fixed steps. Default: `RungeKutta4`.
    precision : Single, optional
        `Single()` writes code that computes in float. Default: double.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters in `start.h`, see `ParameterLayout.values`; nominal if
        None. The functions accept any values.
    t_end : float, optional
        End of the longest run [s], up to which functions of time are checked and, if CasADi cannot
        trace them, interpolated. Default: only traced functions are exported, unchecked.

    Returns
    -------
    list of Path
        The files `tensegrity.c`, `tensegrity.h`, `start.h` (sizes, initial state and control) and
        `main.c`.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, the scheme has a variable step size, or a function of time is not
        finite, raises an error or cannot be traced; the message names it.
    OSError
        The files cannot be written.

    Notes
    -----
    `tensegrity.c` contains four functions in CasADi's calling convention, ``int name(const
    casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem)``:

    - `ode` (x, u) -> xdot;
    - `ode_jacobian` (x, u) -> its dense Jacobians with respect to x and u, column by column;
    - `step` (x, u, h) -> x after one step of `scheme` of h s, followed by the projection onto bars
    and joints;
    - `observe` (x, u) -> the outputs of `Model.observe`.

    If the model has parameters p, each function takes them after u, and `ode_jacobian` ends with
    the Jacobian with respect to p.

    `main.c` integrates from the model's initial state: ``cc -O2 tensegrity.c main.c -lm -o run &&
    ./run t_end step rows``.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> [file.name for file in tc.export_c(model, "prism_in_c")]
    ['tensegrity.c', 'tensegrity.h', 'start.h', 'main.c']
    """
    check_model(model)
    instance("precision", precision, (Single, type(None)), "Single() for float, or None for double")
    check_scheme(scheme)
    if scheme.adaptive:
        raise ValueError(
            f"scheme is {scheme}, which chooses its steps: give one of fixed steps for C, such as RungeKutta4()"
        )
    if precision is not None:
        check_single(scheme)
    if t_end is not None:
        model = _check_functions(model, positive_number("t_end", t_end))
    reject_python_functions(model.scene, "export_c")
    p = model.parameters.values(parameters)
    target = file_path("folder", folder)
    real = "double" if precision is None else "float"
    generator = ca.CodeGenerator("tensegrity.c", {"with_header": True, "casadi_real": real})
    for function in (model.ode, _jacobian(model), _step(model, scheme), model.observe):
        generator.add(function)
    return write_files(
        target,
        {
            **generate_code(generator, "tensegrity"),
            "start.h": _start(model, p, t_end),
            "main.c": _MAIN,
        },
    )


def _check_functions(model: Model, t_end: float) -> Model:
    """Check functions of time up to `t_end`.

    Those that CasADi cannot trace are replaced by interpolants.
    """
    found = model.interpolate_functions(0.0, t_end)
    for part in found.over_time:
        part.check_run(0.0, t_end)
    return found


def _jacobian(model: Model) -> ca.Function:
    """Write the Jacobian of the equations of motion in C.

    A loop over the directions evaluates one directional derivative, so that code and compile time
    stay small.
    """
    given = _inputs(model)
    symbols, seeds = (
        list(given.values()),
        [ca.MX.sym(f"d{name}", symbol.shape[0]) for name, symbol in given.items()],
    )
    slope = model.ode.forward(1)(
        *symbols, ca.MX(model.nx, 1), *seeds
    )  # the input behind the others, xdot, is not needed
    used = [
        k for k, symbol in enumerate(symbols) if symbol.numel()
    ]  # an empty input of a loop makes C that compilers warn of
    directional = ca.Function(
        "directional", [side[k] for side in (symbols, seeds) for k in used], [ca.densify(slope)]
    )
    blocks: list[Any] = []
    for j, own in enumerate(symbols):
        size = own.shape[0]
        along = [
            ca.DM.eye(size) if k == j else ca.DM.zeros(symbol.shape[0], size)
            for k, symbol in enumerate(symbols)
        ]
        inputs = [ca.repmat(symbols[k], 1, size) for k in used] + [
            ca.densify(along[k]) for k in used
        ]
        blocks.append(directional.map(size)(*inputs) if size else ca.MX(model.nx, 0))
    return ca.Function(
        "ode_jacobian", symbols, blocks, list(given), [f"xdot_{name}" for name in given]
    )


def _inputs(model: Model) -> dict[str, ca.MX]:
    """Create the symbols of x, u and, if present, p."""
    sizes = {"x": model.nx, "u": model.nu} | ({"p": model.np} if model.np else {})
    return {name: ca.MX.sym(name, size) for name, size in sizes.items()}


def _step(model: Model, scheme: Scheme) -> ca.Function:
    given, h = _inputs(model), ca.MX.sym("h")
    x, *held = given.values()
    w: Any = ca.vertcat(*held)
    after: Any = split_at_breaks(scheme.advance(model), model)(x, w, h)
    project = Projection().step(model)
    return ca.Function(
        "step",
        [x, *held, h],
        [after if project is None else correct(model, project, after, w)],
        [*given, "h"],
        ["x_next"],
    )


def _start(model: Model, p: Array, t_end: float | None) -> str:
    lines = [
        "/* Sizes, initial state and initial control. Positions first, then velocities, node by node. */",
        f"#define NX {model.nx}",
        f"#define NU {model.nu}",
        f"#define NODES {len(model.structure.nodes)}",
        f"static const casadi_real x_start[{max(model.nx, 1)}] = {_literal(model.start_at(p))};",
        f"static const casadi_real u_start[{max(model.nu, 1)}] = {_literal(model.control_at(p))};",
    ]
    if t_end is not None and model.has_clock:
        lines.append(f"#define T_END {float(t_end)!r} /* functions of time are known until then */")
    if model.np:
        names = "; ".join(
            f"{name}, {unit}"
            for name, unit in zip(model.parameters.names, model.parameters.units, strict=True)
        )
        lines.append(f"/* Parameters: {names.replace('²', '^2').replace('·', ' ')} */")
        lines.append(f"#define NP {model.np}")
        lines.append(f"static const casadi_real p_start[NP] = {_literal(p)};")
    return "\n".join(lines) + "\n"


def _literal(values: Array) -> str:
    return (
        "{"
        + ", ".join(repr(float(value)) for value in (values if values.size else np.zeros(1)))
        + "}"
    )


_MAIN = """/* Integrates the model from its initial state and prints time, node coordinates, energy and bar length error as CSV. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "tensegrity.h"
#include "start.h"

static casadi_real x[NX + 1], next[NX + 1], nodes[3 * NODES], energy[3], bar_error[1];

static void *room(size_t count, size_t size) {
  void *memory = malloc((count + 1) * size);
  if (!memory) { fprintf(stderr, "out of memory\\n"); exit(1); }
  return memory;
}

int main(int argc, char **argv) {
  double t_end = argc > 1 ? atof(argv[1]) : 1.0, h = argc > 2 ? atof(argv[2]) : 1e-3;
  long rows = argc > 3 ? atol(argv[3]) : 10, steps, k, printed = 0;
  if (!(t_end > 0) || !(h > 0) || rows < 1 || t_end / h > 1e12) {
    fprintf(stderr, "usage: %s t_end step rows, all positive\\n", argv[0]);
    return 2;
  }
#ifdef T_END
  if (t_end > T_END * (1 + 1e-9)) {
    fprintf(stderr, "t_end is %g s: functions of time are known until %g s\\n", t_end, T_END);
    return 2;
  }
#endif
  steps = (long)(t_end / h + 0.999999);
  steps = steps < 1 ? 1 : steps;
  h = t_end / (double)steps;

  casadi_int arg = 0, res = 0, iw = 0, w = 0, a, r, i, v;
  step_work(&arg, &res, &iw, &w);
  observe_work(&a, &r, &i, &v);
  arg = a > arg ? a : arg; res = r > res ? r : res; iw = i > iw ? i : iw; w = v > w ? v : w;
  const casadi_real **in = room((size_t)arg, sizeof *in);
  casadi_real **out = room((size_t)res, sizeof *out), *work = room((size_t)w, sizeof *work);
  casadi_int *iwork = room((size_t)iw, sizeof *iwork);
  casadi_real length = (casadi_real)h;

  memcpy(x, x_start, NX * sizeof *x);
  for (k = 0; k <= steps; ++k) {
    if (k * rows >= printed * steps) {
      memset(out, 0, (size_t)res * sizeof *out);
      in[0] = x; in[1] = u_start;
#ifdef NP
      in[2] = p_start;
#endif
      out[0] = nodes; out[4] = energy; out[5] = bar_error;
      if (observe(in, out, iwork, work, 0)) return 1;
      printf("%.9g", (double)k * h);
      for (i = 0; i < 3 * NODES; ++i) printf(",%.17g", (double)nodes[i]);
      printf(",%.17g,%.3g\\n", (double)(energy[0] + energy[1] + energy[2]), (double)bar_error[0]);
      ++printed;
    }
    if (k == steps) break;
    in[0] = x; in[1] = u_start;
#ifdef NP
    in[2] = p_start; in[3] = &length;
#else
    in[2] = &length;
#endif
    out[0] = next;
    if (step(in, out, iwork, work, 0)) { fprintf(stderr, "the step at t = %g failed\\n", (double)k * h); return 1; }
    memcpy(x, next, NX * sizeof *x);
    for (i = 0; i < NX; ++i) {
      if (!(x[i] - x[i] == 0)) { fprintf(stderr, "the state is not finite at t = %g: give a smaller step\\n", (double)(k + 1) * h); return 1; }
    }
  }
  return 0;
}
"""
