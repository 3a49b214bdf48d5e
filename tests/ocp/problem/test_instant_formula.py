"""Formulas of an instant: values of Python functions, in files and in plans."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.problem.instant import symbolic

SCENE = """format = 1
units = "SI"
[numbers]
side = 0.4
tip = 3.0
[structure]
nodes = { hinge = [0, 0, 0], tip = [0, 0, 1], west = [-1, 0, 0], east = [1, 0, 0], south = [0, -1, 0], north = [0, 1, 0] }
bars = [["hinge", "tip"]]
strings = { guys = { members = [["tip", "west"], ["tip", "east"], ["tip", "south"], ["tip", "north"]] } }
pinned = ["hinge", "west", "east", "south", "north"]
[plan]
goals = [{ kind = "NodePositions", positions = { tip = ["side", "free", "free"] } }, "AtRest"]
costs = [{ kind = "Effort", weight = 0.01 }, { kind = "Integral", name = "speed", expression = "vx[tip]**2 + vy[1]**2" }]
[[plan.bounds]]
kind = "ForceDensityLimits"
upper = 300.0
[[plan.bounds]]
kind = "Constraint"
name = "drift"
expression = "EXPRESSION"
lower = 0.09
upper = 0.5
at_end = true
"""


def write(path, expression="y[tip] + 0 * side * tip"):
    path.write_text(SCENE.replace("EXPRESSION", expression), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "function"),
    [
        ("z[3] - 2 * x[0] * t", lambda now: now.nodes[2, 3] - 2 * now.nodes[0, 0] * now.time),
        ("hypot(vx[1], vy[2])", lambda now: ca.hypot(now.velocities[0, 1], now.velocities[1, 2])),
        ("length[top[1]] / k", lambda now: now.lengths[4] / 3.0),
        ("tension[0] + force_density[8]", lambda now: now.tension[0] + now.force_density[8]),
    ],
)
def test_formula_equals_the_function_in_python(text, function):
    model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=100.0), control=tc.ForceDensity()))
    now = symbolic(model)
    formula = ocp.InstantFormula(text, {"k": 3.0, "unused": 1.0})
    both = ca.Function("both", now.symbols, [formula(now), function(now)])
    rng = np.random.default_rng(0)
    given = [model.initial_state + 0.1 * rng.standard_normal(model.nx), rng.uniform(1, 2, 9), 0.7]
    first, second = both(*given)
    assert float(first) == pytest.approx(float(second), rel=1e-14)
    assert formula.numbers.keys() <= {"k"}


def test_plan_keeps_the_formulas_of_its_file(tmp_path):
    problem = ocp.load_problem(write(tmp_path / "drift.toml"))
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert 0.09 - 1e-3 < plan.replay().nodes[-1, 1, 1] < 0.5
    with_speed = ocp.Problem(
        problem.model,
        goals=problem.goals,
        bounds=[
            *problem.bounds[:1],
            ocp.Constraint("drift", lambda now: now.nodes[1, 1], 0.09, 0.5, at_end=True),
        ],
        costs=[
            problem.costs[0],
            ocp.Integral(
                "speed", lambda now: now.velocities[0, 1] ** 2 + now.velocities[1, 1] ** 2
            ),
        ],
    )
    assert plan.objective == pytest.approx(ocp.solve(with_speed).objective, rel=1e-6)
    again = ocp.load_problem(ocp.save_problem(problem, tmp_path / "again.toml"))
    assert again.bounds[1].expression.text == "y[tip] + 0 * (0.4) * (3.0)"
    assert again.costs[1].expression == problem.costs[1].expression
    loaded = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert loaded.problem.bounds[1].name == "drift"


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        ("height[tip]", "'height[tip]' is not known: give x, y, z"),
        ("z[top]", "'z[top]' names node 'top', which is not there"),
        ("length[guys]", "'length[guys]' names 4 strings: give one"),
        ("z[9]", "node indices run from 0 to 5"),
        ("z[tip] +", "is no formula"),
        ("missing", "'missing' is not known"),
    ],
)
def test_names_that_do_not_exist_are_told_with_the_line(expression, words, tmp_path):
    with pytest.raises(tc.SceneFileError) as told:
        ocp.load_problem(write(tmp_path / "x.toml", expression))
    assert words in str(told.value)
    assert "line 20" in str(told.value)
