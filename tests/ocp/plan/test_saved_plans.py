"""Plans in files know how they were asked for and solved: every option comes back as it was, and nothing in a file is run."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planning import save_and_load, taller

import ocp
import tenscasadi as tc

DATA = Path(__file__).parents[2] / "data/before_one_schema"
PRISM = tc.shapes.prism(3, stiffness=1000.0, bar_radius=0.005)
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
NINE = np.linspace(1.0, 2.0, 9) / 3
GOALS = [
    ocp.StringLengths({0: 1.0 / 3, 2: 0.7}),
    ocp.StringLengths(PRISM.string_lengths),
    ocp.NodePositions({0: (0.1, None, None)}),
    ocp.NodePositions(PRISM.nodes),
    ocp.Shape(PRISM.nodes),
    ocp.AtRest(),
    ocp.Waypoint([ocp.Shape(PRISM.nodes), ocp.AtRest()], share=0.5),
    ocp.Waypoint([ocp.AtRest()], time=0.3),
    ocp.Periodic((0.1, 0.0, None)),
]
BOUNDS = [
    ocp.ForceDensityLimits(NINE, 100.0),
    ocp.TensionLimits(upper=NINE * 1e3),
    ocp.RestLengthLimits(0.01, 2.0),
    ocp.RestLengthRateLimits(NINE, stiffness=2000.0),
    ocp.BarForceLimits(compression=1e3),
    ocp.Buckling(7e10),
    ocp.InsideBox((None, -9.0, None), (9.0, None, None), nodes=[0, 1]),
    ocp.AboveGround(-1.0),
    ocp.AboveSurface(
        tc.Ground(normal=(0.1, 0.2, 1.0), height=-2.0, friction=0.3), -0.1, nodes=[0, 2]
    ),
    ocp.AboveSurface(tc.Terrain([[-5.0, -4.0], [-3.0, -4.0]], (-1, -1), (1, 1))),
    ocp.BarClearance(0.001, pairs=[(0, 1)]),
    ocp.Obstacle((5.0, 5.0, 5.0), 0.1),
]
COSTS = [
    ocp.Effort(0.1),
    ocp.Smoothness(),
    ocp.Prestress(NINE),
    ocp.Tracking({1: (0.0, None, 1.0)}),
    ocp.Duration(),
    ocp.Work(0.5),
]
TRANSCRIPTIONS = [
    ocp.MultipleShooting(
        7,
        scheme=tc.Collocation(degree=3),
        substeps=2,
        control=ocp.PiecewiseLinear(groups=((0, 1, 2),)),
    ),
    ocp.MultipleShooting((1.0, 2.0, 3.0), scheme=tc.DormandPrince853()),
    ocp.ImplicitMidpoint(np.int64(5), accuracy=1e-5),
    ocp.Variational(3),
    ocp.DirectCollocation(4, degree=3),
]
SOLVERS = [
    ocp.Ipopt(
        50, time_limit=2.0, options={"mu_strategy": "adaptive", "acceptable_tol": np.float64(1e-6)}
    ),
    ocp.CondensedNewton(50),
]


def same(one: Any, other: Any) -> bool:
    """Equal, bit by bit; lists of numbers are arrays."""
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(
            same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)
        )
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    return bool(one == other)


@pytest.mark.parametrize("field", ["goals", "bounds", "costs"])
def test_problems_come_back(field):
    every = {"goals": GOALS, "bounds": BOUNDS, "costs": COSTS}
    asked = ocp.Problem(MODEL, 1.0 if field == "goals" else (0.5, 1.5), **{field: every[field]})
    found = save_and_load(model=MODEL, problem=asked)
    assert found["problem"].duration == asked.duration
    assert np.abs(found["problem"].start - asked.start).max() < 1e-14
    assert same(getattr(found["problem"], field), getattr(asked, field))


def test_a_free_start_comes_back():
    asked = ocp.Problem(
        MODEL, start=ocp.FreeStart(goals=[ocp.NodePositions({0: (0.1, None, None)})])
    )
    found = save_and_load(model=MODEL, problem=asked)["problem"]
    assert same(found.start.goals, asked.start.goals)
    assert np.abs(found.start.near - asked.start.near).max() < 1e-14


@pytest.mark.parametrize("transcription", TRANSCRIPTIONS)
@pytest.mark.parametrize("solver", SOLVERS)
def test_transcriptions_and_solvers_come_back(transcription, solver):
    found = save_and_load(
        model=MODEL, problem=ocp.Problem(MODEL), transcription=transcription, solver=solver
    )
    assert same(found["transcription"], transcription)
    assert same(found["solver"], solver)


# --- plans in files ---


def test_a_loaded_plan_is_refined_and_reports_of_its_problem(coarse, tmp_path):
    loaded = ocp.Plan.load(coarse.save(tmp_path / "plan.npz"))
    assert str(loaded.report()) == str(coarse.report())
    fine, again = (plan.refine(1e-4) for plan in (coarse, loaded))
    assert again.success
    assert again.time == pytest.approx(fine.time, abs=1e-9)
    assert again.force_density == pytest.approx(fine.force_density, rel=1e-6)
    assert ocp.Plan.load(path=again.save(tmp_path / "again.npz")).refine(1e-4).success


def without(path, *names, **others):
    """The file with other fields."""
    with np.load(path) as archive:
        content = {name: archive[name] for name in archive.files if name not in names}
    np.savez_compressed(path, **content, **others)
    return path


@pytest.mark.parametrize("many", [1_000_000_000, 200_000])
def test_a_file_that_asks_for_too_many_intervals_is_a_plan_that_cannot_be_refined(
    coarse, many, tmp_path
):
    path = coarse.save(tmp_path / "plan.npz")
    with np.load(path) as archive:
        text = re.sub(r'"intervals": \d+', f'"intervals": {many}', archive["plan"].item())
    loaded = ocp.Plan.load(without(path, "plan", plan=np.asarray(text)))
    assert loaded.success
    assert loaded.transcription is None
    with pytest.raises(
        ValueError,
        match=r"refine needs to know how the plan was solved \(plan.*\w+\.intervals is .*: it must be at most 100000\)",
    ):
        loaded.refine(1e-4)


def test_a_plan_of_an_older_version_says_how_it_is_refined(tmp_path):
    path = tmp_path / "plan.npz"
    path.write_bytes((DATA / "plan.npz").read_bytes())
    assert ocp.Plan.load(path).report()
    loaded = ocp.Plan.load(without(path, "solved"))
    assert loaded.replay().success
    with pytest.raises(ValueError, match=r"older version.*Plan.load\(path, problem=...\)"):
        loaded.report()
    for plan in (loaded, ocp.Plan.load(path, taller())):
        with pytest.raises(
            ValueError,
            match=r"how the plan was solved \(its file is of an older version\).*guess=plan",
        ):
            plan.refine(1e-6)
    assert ocp.Plan.load(path, taller()).report()


class OwnScheme(tc.RungeKutta4):
    """A scheme as users write them."""


@pytest.mark.parametrize("own", ["cost", "scheme"])
def test_what_no_file_holds_is_said_where_it_is_needed(own, tmp_path):
    costs = [
        ocp.Effort(),
        *([ocp.Integral("low", lambda now: now.nodes[2, 0] ** 2)] if own == "cost" else []),
    ]
    asked = replace(taller(), costs=costs)
    transcription = ocp.MultipleShooting(
        8, scheme=OwnScheme() if own == "scheme" else tc.RungeKutta4()
    )
    path = ocp.solve(asked, transcription, ocp.Ipopt(callback=lambda progress: True)).save(
        tmp_path / "plan.npz"
    )
    said = (
        "Problem.costs[1] is Integral 'low', a function in Python"
        if own == "cost"
        else "MultipleShooting.scheme: OwnScheme() is none of Collocation, Cvodes"
    )
    with pytest.raises(ValueError, match=f"{re.escape(said)}.*guess=plan"):
        ocp.Plan.load(path).refine(1e-4)
    if own == "cost":
        assert ocp.Plan.load(path, asked).refine(1e-4).success


@pytest.mark.parametrize(
    "parts",
    [
        {"transcription": [], "solver": 3},
        {"transcription": {"kind": "os.system"}},
        {"solver": {"kind": "Ipopt", "options": {"hsllib": "/tmp/own.so"}}},
    ],
    ids=["nothing", "another class", "a library"],
)
def test_nothing_in_a_file_is_run(coarse, parts, tmp_path):
    path = coarse.save(tmp_path / "plan.npz")
    with np.load(path) as archive:
        tables = json.loads(archive["plan"].item())
    tables["plan"] |= parts
    loaded = ocp.Plan.load(without(path, "plan", plan=np.asarray(json.dumps(tables))))
    assert all(getattr(loaded, name) is None for name in parts)
    with pytest.raises(ValueError, match="how the plan was solved"):
        loaded.refine(1e-4)


def test_a_plan_without_values_is_rejected(coarse, tmp_path):
    path = without(coarse.save(tmp_path / "plan.npz"), "plan", plan=np.asarray("no json"))
    with pytest.raises(ValueError, match=r"plan.npz is not a plan: field 'plan'"):
        ocp.Plan.load(path)
