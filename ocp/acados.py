"""Export of predictive control problems for acados."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ocp.control.mpc import Mpc
from ocp.problem.path_constraints import ScaledRows
from ocp.sampling.horizon_costs import OVERSTEP
from tenscasadi.util.validate import Array, file_path, instance
from tenscasadi.util.whole_file import write_files

NO_LIMIT = 1e10  # acados' number for an absent limit


def export_acados(mpc: Mpc, folder: str | Path) -> list[Path]:
    """Write a predictive control problem for acados.

    Parameters
    ----------
    mpc : Mpc
        Controller with the problem.
    folder : str or Path
        Folder of the files, which is created if necessary.

    Returns
    -------
    list of Path
        `acados_mpc.py` and `mpc.json`, which has numbers and serialized CasADi Functions.

    Raises
    ------
    TypeError, ValueError
        If `mpc` is not an `Mpc`, or has rate limits or limits of forces at the end of the horizon,
        which acados does not support.
    OSError
        If a file cannot be written.

    Notes
    -----
    `acados_mpc.py` requires CasADi and NumPy; its function `make_ocp` also requires
    `acados_template`, and returns an `AcadosOcp`. `expressions` returns x, u, p, xdot, f_expl,
    f_impl, y, y_e, h and h_e. The parameter p is the time [s] of a stage. `references(time)` returns
    `yref` of all stages, to be set before each solution.

    The cost is that of `Mpc`: ½ ‖y − yref‖² with scaled outputs and controls, in the form
    NONLINEAR_LS. Controls have bounds. Other limits h are soft, and hold at the starts of intervals;
    those that do not depend on the control also at the end of the horizon. The integrator is RK4
    with the steps of `mpc`.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> controller = ocp.Mpc(ocp.Problem(cross, goals=[ocp.AtRest()]), period=0.1, intervals=2)
    >>> [path.name for path in ocp.export_acados(controller, mkdtemp())][:2]
    ['acados_mpc.py', 'mpc.json']
    """
    instance("mpc", mpc, Mpc, "an ocp.Mpc")
    target = file_path("folder", folder)
    model, own = mpc.model, mpc.formulation
    if own.rates:
        raise ValueError(
            f"mpc limits the {own.rates[0]}, a difference of two instants: leave rate limits out, "
            "or keep to ocp.export_mpc"
        )
    path, end = _Limits(mpc), _Limits(mpc)
    for rows in own.limits:
        controlled = set(rows.function.jac_sparsity(0, 1).get_triplet()[0])
        free = [k for k in range(len(rows.names)) if k not in controlled]
        if rows.ends != ("last",):
            path.add(rows, list(range(len(rows.names))))
        elif controlled:
            raise ValueError(
                f"mpc limits the {rows.names[min(controlled)]} at the end of the horizon, where "
                "acados has no control: leave that limit out, or keep to ocp.export_mpc"
            )
        end.add(rows, free)
    least, most = mpc.problem.control_limits
    functions = {
        "ode": own.ode,
        "output": own.output,
        "reference": own.reference,
        "path": path.function("path"),
        "end": end.function("end"),
    }
    data = {
        "nx": model.nx,
        "nu": model.nu,
        "horizon": mpc.intervals,
        "period": mpc.period,
        "substeps": own.substeps,
        "control_scale": own.control_scale.tolist(),
        "control": {"lower": _finite(least), "upper": _finite(most)},
        "path": path.numbers(),
        "end": end.numbers(),
        "slack_penalty": OVERSTEP,
        "initial_state": model.initial_state.tolist(),
        "functions": {name: function.serialize() for name, function in functions.items()},
    }
    return write_files(target, {"acados_mpc.py": _SCRIPT, "mpc.json": json.dumps(data, indent=1)})


class _Limits:
    """Limits lower ≤ value ≤ upper of an instant, collected for acados.

    They are the path constraints of the controller `mpc`.
    """

    def __init__(self, mpc: Mpc) -> None:
        self.symbols = [ca.MX.sym("x", mpc.model.nx), ca.MX.sym("u", mpc.model.nu), ca.MX.sym("t")]
        self.values: list[Any] = [ca.MX(0, 1)]
        self.lower: list[float] = []
        self.upper: list[float] = []
        self.names: list[str] = []

    def add(self, rows: ScaledRows, kept: list[int]) -> None:
        """Add the constraint rows with the indices `kept`."""
        self.values.append(rows.function(*self.symbols)[kept])
        self.lower += _finite(rows.lower[kept])
        self.upper += _finite(rows.upper[kept])
        self.names += [rows.names[k] for k in kept]

    def function(self, name: str) -> ca.Function:
        """Build the Function (x, u, t) → values, called `name`."""
        return ca.Function(name, self.symbols, [ca.densify(ca.vertcat(*self.values))])

    def numbers(self) -> dict[str, Any]:
        """Collect limits and names."""
        return {"lower": self.lower, "upper": self.upper, "names": self.names}


def _finite(limits: Array) -> list[float]:
    return [float(value) for value in np.clip(limits, -NO_LIMIT, NO_LIMIT)]


_SCRIPT = '''"""Predictive control problem for acados, written by tenscasadi.

    from acados_template import AcadosOcpSolver
    import acados_mpc

    solver = AcadosOcpSolver(acados_mpc.make_ocp())
    for stage, reference in enumerate(acados_mpc.references(time)):
        solver.cost_set(stage, "yref", reference)
        solver.set(stage, "p", [time + stage * acados_mpc.DATA["period"]])
    control = solver.solve_for_x0(state)  # until the next decision

acados_mpc.make_ocp requires acados and acados_template; everything else, CasADi and NumPy.
"""

import json
from pathlib import Path

import casadi as ca
import numpy as np

DATA = json.loads(Path(__file__).with_name("mpc.json").read_text(encoding="utf-8"))
FUNCTIONS = {name: ca.Function.deserialize(text) for name, text in DATA["functions"].items()}


def expressions():
    """Return x, u, p and the expressions of them by name."""
    x, u, p = ca.MX.sym("x", DATA["nx"]), ca.MX.sym("u", DATA["nu"]), ca.MX.sym("p", 1)
    xdot = ca.MX.sym("xdot", DATA["nx"])
    rate, output = FUNCTIONS["ode"](x, u), FUNCTIONS["output"](x)
    return {
        "x": x,
        "u": u,
        "p": p,  # time of the stage, s
        "xdot": xdot,
        "f_expl": rate,
        "f_impl": xdot - rate,
        "y": ca.vertcat(output, u / ca.DM(DATA["control_scale"])),
        "y_e": output,
        "h": FUNCTIONS["path"](x, u, p),
        "h_e": FUNCTIONS["end"](x, 0, p),
    }


def references(time):
    """Return yref of all stages, with the terminal one last."""
    output, control = (value.full() for value in FUNCTIONS["reference"](time))
    along = np.column_stack([output[:, :1], output[:, :-1]])  # the output now is no choice
    stages = np.vstack([along, control / np.array(DATA["control_scale"])[:, None]])
    return [*stages.T, output[:, -1]]


def make_ocp():
    """Build the AcadosOcp."""
    from acados_template import AcadosModel, AcadosOcp

    own, ocp, model = expressions(), AcadosOcp(), AcadosModel()
    model.name = "tensegrity"
    model.x, model.u, model.p, model.xdot = (own[name] for name in ("x", "u", "p", "xdot"))
    model.f_expl_expr, model.f_impl_expr = own["f_expl"], own["f_impl"]
    model.cost_y_expr, model.cost_y_expr_e = own["y"], own["y_e"]
    ocp.model, ocp.parameter_values = model, np.zeros(1)

    first = references(0.0)
    ocp.cost.cost_type = ocp.cost.cost_type_e = "NONLINEAR_LS"
    ocp.cost.W = np.eye(len(first[0])) / DATA["period"]  # acados multiplies by the time step
    ocp.cost.W_e = np.eye(len(first[-1]))
    ocp.cost.yref, ocp.cost.yref_e = first[0], first[-1]

    limits = ocp.constraints
    limits.x0 = np.array(DATA["initial_state"])
    limits.idxbu = np.arange(DATA["nu"])
    limits.lbu, limits.ubu = (np.array(DATA["control"][side]) for side in ("lower", "upper"))
    for kind, end in (("path", "_0"), ("path", ""), ("end", "_e")):
        count = len(DATA[kind]["names"])
        if count:  # soft limits
            setattr(model, "con_h_expr" + end, own["h_e" if kind == "end" else "h"])
            setattr(limits, "lh" + end, np.array(DATA[kind]["lower"]))
            setattr(limits, "uh" + end, np.array(DATA[kind]["upper"]))
            setattr(limits, "idxsh" + end, np.arange(count))
            for weight in ("zl", "zu", "Zl", "Zu"):
                setattr(ocp.cost, weight + end, np.full(count, DATA["slack_penalty"]))

    options = ocp.solver_options
    options.N_horizon = DATA["horizon"]
    options.tf = DATA["horizon"] * DATA["period"]
    options.integrator_type = "ERK"
    options.sim_method_num_stages, options.sim_method_num_steps = 4, DATA["substeps"]
    options.nlp_solver_type, options.hessian_approx = "SQP_RTI", "GAUSS_NEWTON"
    options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    return ocp
'''
