"""Programs and controllers as C: they compile without a warning and without CasADi at hand, and give the numbers of its virtual machine."""

from __future__ import annotations

import csv
import ctypes
import re
import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.search.methods import program_of

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
ARM = tc.Structure(
    [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)],
    bars=[(0, 1)],
    strings=[(1, 2), (1, 3), (1, 4), (1, 5)],
    pinned=[0, 2, 3, 4, 5],
)
MODEL = tc.Model(tc.Scene(ARM, control=tc.ForceDensity()))


def problem(**changes):
    goals = [ocp.NodePositions({1: (0.4, 0.0, None)}), ocp.AtRest()]
    bounds = [ocp.ForceDensityLimits(1.0, 50.0), ocp.TensionLimits(upper=30.0)]
    return ocp.Problem(
        MODEL, **{"goals": goals, "bounds": bounds, "costs": [ocp.Effort()], **changes}
    )


def built(folder, name):
    """A library, compiled as strictly as can be."""
    path = folder / f"{name}.so"
    assert COMPILER is not None
    subprocess.run(
        [
            COMPILER,
            "-std=c99",
            "-O0",
            "-Wall",
            "-Werror",
            "-fPIC",
            "-shared",
            f"{name}.c",
            "-lm",
            "-o",
            path,
        ],
        cwd=folder,
        check=True,
    )
    return path


def table(path):
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        name: [row[name] for row in rows]
        if name == "name"
        else np.array([float(row[name]) for row in rows])
        for name in rows[0]
    }


CASES = {
    "shooting": (ocp.MultipleShooting(3), {}),
    "variational": (ocp.Variational(4), {}),
    "free duration": (ocp.ImplicitMidpoint(3), {"duration": (0.5, 1.0)}),
}


@pytest.mark.parametrize("case", CASES)
def test_an_exported_program_has_the_values_of_the_virtual_machine(case, tmp_path):
    transcription, changes = CASES[case]
    files = ocp.export_program(problem(**changes), transcription, tmp_path / "c")
    assert [path.name for path in files] == ["program.c", "program.h", "unknowns.csv", "rows.csv"]
    assert all(path.exists() for path in files)
    program = program_of(problem(**changes), transcription)
    unknowns, rows = table(files[2]), table(files[3])
    assert tuple(unknowns["name"]) == program.w_names
    assert tuple(rows["name"]) == program.names
    for column, values in (
        ("scale", program.w_scale),
        ("lower", program.w_lower),
        ("upper", program.w_upper),
        ("first", program.first),
    ):
        assert np.array_equal(unknowns[column], values)
    for column, values in (
        ("scale", program.scale),
        ("lower", program.lower),
        ("upper", program.upper),
    ):
        assert np.array_equal(rows[column], values)
    library = str(built(tmp_path / "c", "program"))
    rng = np.random.default_rng(0)
    w, lam = (
        unknowns["first"] + 0.1 * rng.normal(size=len(program.w_names)),
        rng.normal(size=len(program.names)),
    )
    x = program.problem["x"]
    for name in "fg":
        ours = ca.Function("own", [x], [program.problem[name]])(w)
        assert ca.external(f"nlp_{name}", library)(w, []).full() == pytest.approx(
            ours.full(), rel=1e-12, abs=1e-12
        )
    for name, function in program.derivatives().items():
        given = (w, [], 0.7, lam)[: function.n_in()]
        ours, theirs = (call(*given) for call in (function, ca.external(name, library)))
        pairs = zip(ours, theirs, strict=True) if isinstance(ours, tuple) else [(ours, theirs)]
        for one, other in pairs:
            assert other.sparsity() == one.sparsity()
            assert other.full() == pytest.approx(one.full(), rel=1e-12, abs=1e-12)
    header = (tmp_path / "c" / "program.h").read_text(encoding="utf-8")
    assert f"{len(program.w_names)} unknowns (unknowns.csv), {len(program.names)} rows" in header
    assert "nlp_hess_l: x[" in header


def reader(path, sizes):
    """The function `decide` of a library, called as a C program calls it, with its status."""
    library = ctypes.CDLL(str(path))
    doubles = ctypes.POINTER(ctypes.c_double)
    work = [ctypes.c_longlong() for _ in range(4)]
    assert library.decide_work(*map(ctypes.byref, work)) == 0
    n_arg, n_res, n_iw, n_w = (size.value for size in work)
    iw, w = (ctypes.c_longlong * (n_iw + 1))(), (ctypes.c_double * (n_w + 1))()

    def decide(*inputs):
        given = [np.ascontiguousarray(value, dtype=float).ravel() for value in inputs]
        after, status = np.zeros(sizes), np.full(1, np.nan)
        arg, res = (doubles * (n_arg + 1))(), (doubles * (n_res + 1))()
        for k, value in enumerate(given):
            arg[k] = value.ctypes.data_as(doubles)
        res[0], res[1] = (value.ctypes.data_as(doubles) for value in (after, status))
        assert library.decide(arg, res, iw, w, 0) == 0
        return after, status[0]

    return decide


CONTROLLERS = {
    "to a goal": lambda: ocp.Mpc(problem(), 0.1, 4, iterations=2),
    "along a plan": lambda: ocp.Mpc(
        problem(), 0.1, 4, plan=ocp.solve(problem(), ocp.MultipleShooting(10)), substeps=2
    ),
    "along a linear plan": lambda: ocp.Mpc(
        problem(),
        0.1,
        4,
        plan=ocp.solve(problem(), ocp.Variational((1, 2, 1, 2, 2), control=ocp.PiecewiseLinear())),
    ),
    "with limits of rates": lambda: ocp.Mpc(
        problem(bounds=[ocp.RestLengthRateLimits(0.3, stiffness=1000.0)]), 0.1, 4
    ),
    "without limits of the path": lambda: ocp.Mpc(problem(bounds=[]), 0.1, 3),
}


@pytest.mark.parametrize("case", CONTROLLERS)
def test_an_exported_controller_decides_as_the_controller(case, tmp_path):
    mpc = CONTROLLERS[case]()
    files = ocp.export_mpc(mpc, tmp_path)
    assert [path.name for path in files] == ["mpc.c", "mpc.h"]
    header = files[1].read_text(encoding="utf-8")
    constants = dict(re.findall(r"#define (MPC_\w+) (.+)", header))
    assert (
        int(constants["MPC_STATES"]),
        int(constants["MPC_STRINGS"]),
        float(constants["MPC_PERIOD"]),
    ) == (MODEL.nx, MODEL.nu, mpc.period)
    before = np.array(constants["MPC_FIRST"].strip("{}").split(","), dtype=float)
    decide = reader(built(tmp_path, "mpc"), mpc.intervals * MODEL.nu)
    state, decided = np.array(MODEL.initial_state), []
    earlier = [np.full(MODEL.nx, np.nan)] if "earlier[" in header else []
    assert bool(earlier) is ("rates" in case)
    for k in range(14):
        if k == 5:  # a push
            state[MODEL.nq : MODEL.nq + 2] += [0.3, -0.2]
        ours = mpc.control(k * mpc.period, state)
        before, status = decide(k * mpc.period, state, before, *earlier)
        assert status == 0
        assert before[: MODEL.nu] == pytest.approx(ours, abs=1e-5 * 50.0)
        earlier = [state] * len(earlier)
        state = (
            tc.simulate(
                MODEL, mpc.period, mpc.period / 20, state=state, control=ours, compiled=False
            )
            .states[-1]
            .copy()
        )
        decided.append(ours)
    assert np.ptp(decided, axis=0).max() > 1.0  # there was something to decide


def test_an_exported_controller_reports_failures_and_obeys_limits(tmp_path):
    """A state that is NaN is a status; limits of the path that no control keeps are violated little."""
    mpc = ocp.Mpc(
        problem(bounds=[ocp.ForceDensityLimits(1.0, 50.0), ocp.TensionLimits(0.5, 0.6)]), 0.1, 4
    )
    ocp.export_mpc(mpc, tmp_path)
    decide = reader(built(tmp_path, "mpc"), 4 * MODEL.nu)
    for state, expected in ((MODEL.initial_state, 0), (MODEL.initial_state * np.nan, 1)):
        after, status = decide(0.0, state, mpc.first.T)
        assert (status, float(mpc.function()(0.0, state, mpc.first)[1])) == (expected, expected)
        assert np.all((after >= 1.0) & (after <= 50.0))


def test_the_header_has_the_unit_of_the_control(tmp_path):
    model = tc.Model(tc.Scene(ARM, control=tc.Tension()))
    task = ocp.Problem(model, goals=[ocp.AtRest()], bounds=[ocp.TensionLimits(1.0, 50.0)])
    ocp.export_mpc(ocp.Mpc(task, 0.1, 2), tmp_path)
    assert "before N) -> after N, status" in (tmp_path / "mpc.h").read_text(encoding="utf-8")


def test_the_first_decision_is_that_of_the_reference():
    mpc = CONTROLLERS["along a plan"]()
    state = MODEL.initial_state
    after, status = mpc.function()(0.0, state, mpc.first)
    assert after.full()[:, 0] == pytest.approx(mpc.control(0.0, state), abs=1e-6)
    assert status == 0


def test_an_accuracy_is_said_to_be_no_part_of_a_program(tmp_path):
    for accuracy, said in ((None, False), (1e-4, True)):
        ocp.export_program(
            problem(), ocp.Variational(3, accuracy=accuracy), tmp_path / str(accuracy)
        )
        head = (tmp_path / str(accuracy) / "program.h").read_text()
        assert ("Variational.accuracy is 0.0001 m: not part of this program" in head) is said


def test_wrong_values_are_refused(tmp_path):
    with pytest.raises(TypeError, match="mpc"):
        ocp.export_mpc(problem(), tmp_path)
    with pytest.raises(TypeError, match="transcription"):
        ocp.export_program(problem(), 40, tmp_path)
