"""Problems in scene files: what comes back is what was written, and what no file holds is refused by name."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from ocp_problems.shape_changes import ball, free_prism, heavy_strings, standing_prism
from ocp_problems.tasks import (
    in_full_coordinates,
    limited,
    prism_by_way_of,
    quickest,
    reach,
    slow,
    there_and_back,
    within,
)

import ocp
import tenscasadi as tc

FOLDER = tc.__path__[0] + "/cli/templates"
HEAD = 'format = 1\nunits = "SI"\n'
ARM = """
[structure]
nodes = { hinge = [0, 0, 0], tip = [0, 0, 1], west = [-1, 0, 0], east = [1, 0, 0], south = [0, -1, 0], north = [0, 1, 0] }
bars = [["hinge", "tip"]]
strings = { guys = { members = [["tip", "west"], ["tip", "east"], ["tip", "south"], ["tip", "north"]] } }
pinned = ["hinge", "west", "east", "south", "north"]
"""


@pytest.fixture
def written(tmp_path):
    """Writes a scene file."""

    def write(text, name="scene.toml"):
        (tmp_path / name).write_text(HEAD + text, encoding="utf-8")
        return tmp_path / name

    return write


def plane(friction=0.6):
    return tc.Ground(stiffness=1e4, damping=20.0, friction=friction, slip_speed=0.01)


def jump():
    """Feet push off and fly: a problem of two phases."""
    standing = tc.Scene(
        tc.shapes.prism(bar_mass=0.3),
        control=tc.ForceDensity(),
        gravity=tc.Gravity(),
        ground=plane(),
    )
    push = ocp.Phase(
        (0.1, 0.5), contact_nodes=[0, 1, 2], bounds=[ocp.ForceDensityLimits(2.0, 400.0)]
    )
    flight = ocp.Phase((0.05, 0.5), goals=[ocp.CenterOfMass((None, None, 0.7))])
    return ocp.Problem(
        tc.Model(standing),
        goals=[ocp.NodeVelocities({0: (None, None, 0.0)})],
        phases=[push, flight],
        costs=[ocp.Effort()],
    )


def wished():
    """Soft goals, at the end and on the way."""
    asked = free_prism(3, 1.0, 1.1)
    soft = [
        ocp.StringLengths({0: 0.8}).soft(1e4),
        ocp.Waypoint([ocp.NodePositions({5: (None, None, 1.05)}).soft(10.0)], share=0.5),
    ]
    return ocp.Problem(
        asked.model,
        1.0,
        goals=[*asked.goals, *soft],
        bounds=asked.bounds,
        costs=[ocp.Smoothness(1e-3)],
    )


def gait():
    """A free start that the end repeats, further on."""
    model = free_prism(3, 1.0, 1.1).model
    return ocp.Problem(
        model,
        (0.5, 1.0),
        start=ocp.FreeStart(
            near=model.structure.nodes + [0.125, 0, 0],
            goals=[ocp.NodePositions({0: (0.5, None, None)})],
        ),
        goals=[ocp.Periodic(shift=(0.1, None, 0.0))],
        bounds=[
            ocp.ForceDensityLimits(1.0, 100.0),
            ocp.AboveSurface(tc.Ground(height=-5.0), 0.1, nodes=[3]),
        ],
    )


def wound():
    """Rest lengths are planned."""
    prism = tc.shapes.prism(stiffness=1000.0, prestress=50.0)
    goals = [ocp.StringLengths(tc.shapes.prism(height=1.02, radius=0.49).string_lengths)]
    limits = [ocp.RestLengthLimits(upper=2.0), ocp.TensionLimits(upper=np.linspace(50.0, 90.0, 9))]
    return ocp.Problem(
        tc.Model(tc.Scene(prism, control=tc.RestLength())), 0.4, goals=goals, bounds=limits
    )


def tracked_path():
    """A tip is led along a line, around an obstacle and within a box."""
    asked = reach(0.4)
    bounds = [
        *asked.bounds,
        ocp.Obstacle((0.3, 0.8, 0.9), 0.1, nodes=[1]),
        ocp.InsideBox(upper=(None, None, 1.2)),
        ocp.ForceDensityRateLimits(1e4),
    ]
    costs = [ocp.Tracking({1: (0.2, 0.1, None)}, weight=3.0), ocp.Prestress(20.0), ocp.Work(1e-3)]
    return ocp.Problem(asked.model, 1.0, goals=asked.goals, bounds=bounds, costs=costs)


PROBLEMS = {
    "free prism": lambda: free_prism(3, 1.0, 1.15),
    "prism on its feet": lambda: standing_prism(3, 0.1),
    "free duration": lambda: free_prism(3, 1.0, 1.1, (0.6, 1.6)),
    "ball": lambda: ball(0.95),
    "there and back": there_and_back,
    "waypoints": lambda: prism_by_way_of(1.1, 0.9),
    "least time": lambda: quickest(reach(0.4)),
    "arm under its weight": lambda: reach(0.4, True),
    "bars apart": lambda: within(
        free_prism(3, 1.0, 1.1),
        ocp.BarClearance(0.05, pairs=[(0, 1)]),
        ocp.BarForceLimits(compression=30.0),
    ),
    "winding": lambda: limited(
        ocp.RestLengthRateLimits(0.4, stiffness=1000.0), ocp.TensionLimits(upper=12.0)
    ),
    "massive strings": lambda: heavy_strings(3, 2),
    "full coordinates": lambda: in_full_coordinates(reach(0.4)),
    "phases": jump,
    "soft goals": wished,
    "free start": gait,
    "rest lengths": wound,
    "tracking": tracked_path,
}


def told(problem):
    """All that a problem asks, in numbers."""

    def plain(value):
        if isinstance(value, np.ndarray):
            return value.tolist()
        if isinstance(value, (list, tuple)):
            return [plain(entry) for entry in value]
        if hasattr(value, "__dataclass_fields__"):
            return type(value).__name__, {
                name: plain(getattr(value, name)) for name in value.__dataclass_fields__
            }
        return (
            {key: plain(entry) for key, entry in value.items()}
            if isinstance(value, dict)
            else value
        )

    return {
        name: plain(getattr(problem, name)) for name in ("duration", "goals", "bounds", "phases")
    }


@pytest.mark.parametrize("name", PROBLEMS)
def test_problems_come_back(name, tmp_path):
    problem = PROBLEMS[name]()
    again = ocp.load_problem(ocp.save_problem(problem, tmp_path / "problem.toml"))
    assert told(again) == told(problem)
    assert np.array_equal(again.initial_state, problem.initial_state)
    assert repr(again.initial_goals) == repr(problem.initial_goals)
    assert [type(cost) for cost in again.costs] == [type(cost) for cost in problem.costs]
    x, u = np.linspace(0.3, 1.7, problem.model.nx), np.linspace(0.5, 2.0, problem.model.nu)
    assert np.array_equal(np.asarray(again.model.ode(x, u)), np.asarray(problem.model.ode(x, u)))
    assert (
        ocp.save_problem(again, tmp_path / "again.toml").read_text()
        == (tmp_path / "problem.toml").read_text()
    )


@pytest.mark.parametrize("name", ["prism on its feet", "waypoints", "soft goals", "tracking"])
def test_problems_that_come_back_have_the_same_plan(name, tmp_path):
    problem = PROBLEMS[name]()
    way = {"transcription": ocp.Variational(10), "solver": ocp.Ipopt(options={"mu_init": 0.05})}
    plan = ocp.solve(problem, **way)
    again = ocp.solve(
        **ocp.load_solve_arguments(ocp.save_problem(problem, tmp_path / "problem.toml", **way))
    )
    assert np.array_equal(again.force_density, plan.force_density)
    assert np.array_equal(again.trajectory.states, plan.trajectory.states)


WAYS = [
    {
        "transcription": ocp.MultipleShooting(
            7, accuracy=1e-6, scheme=tc.DormandPrince54(), substeps=2
        )
    },
    {
        "transcription": ocp.ImplicitMidpoint(
            5, control=ocp.PiecewiseLinear(groups=[(0, 1), (2, 3)])
        )
    },
    {
        "transcription": ocp.DirectCollocation(
            [1.0, 2.0, 1.0], control=ocp.PiecewiseConstant(max_changes=1), degree=3
        ),
        "solver": ocp.Ipopt(tolerance=1e-6),
    },
    {
        "solver": ocp.CondensedNewton(max_iterations=9),
        "guess": ocp.InverseDynamics(noise=0.1, seed=3),
        "tolerance": 1e-3,
    },
    {
        "solver": ocp.Sampling(groups=[(0, 1)], samples=64),
        "guess": ocp.EquilibriumGuess(),
        "n_starts": 3,
        "time_limit": 9.0,
        "tracked": True,
    },
    {
        "solver": ocp.Ipopt(
            50,
            options={"linear_solver": "mumps", "mu_init": 0.1, "mehrotra_algorithm": "no"},
            time_limit=4.0,
            warm_start=True,
        )
    },
    {"guess": ocp.TrajectoryGuess(np.arange(12.0).reshape(2, 6), np.ones((3, 4)), 0.5)},
]


@pytest.mark.parametrize("way", WAYS, ids=[" ".join(way) for way in WAYS])
def test_how_it_is_solved_comes_back(way, tmp_path):
    arguments = ocp.load_solve_arguments(
        ocp.save_problem(reach(0.4), tmp_path / "problem.toml", **way)
    )
    assert set(arguments) == {"problem", *way}
    for name, value in way.items():
        assert repr(arguments[name]) == repr(value)


def test_what_no_file_holds_is_refused_by_name(tmp_path):
    cases = {
        r"Problem.bounds\[1\] is Constraint 'speed'": limited(slow(0.2)),
        r"Problem.costs\[1\] is AtEnd 'height'": limited(
            costs=(ocp.Effort(), ocp.AtEnd("height", lambda end: -end.nodes[2, 3]))
        ),
        r"Problem.costs\[0\] is Integral 'height'": limited(
            costs=(ocp.Integral("height", lambda now: now.nodes[2, 3]),)
        ),
        "Tracking.positions: a function of time": limited(
            costs=(ocp.Tracking({3: lambda t: (ca.cos(t), None, None)}),)
        ),
    }
    for named, problem in cases.items():
        with pytest.raises(ValueError, match=f"problem cannot be written, .*{named}"):
            ocp.save_problem(problem, tmp_path / "problem.toml")
    with pytest.raises(ValueError, match=r"solver: Ipopt.options: .*no number, flag or word"):
        ocp.save_problem(
            reach(0.4), tmp_path / "problem.toml", solver=ocp.Ipopt(options={"mu_init": np.ones(2)})
        )
    with pytest.raises(ValueError, match=r"Ipopt\.callback: a function in Python: leave it out"):
        ocp.save_problem(reach(0.4), tmp_path / "problem.toml", solver=ocp.Ipopt(callback=print))
    with pytest.raises(ValueError, match=r"^n_starts is 0: it must be at least 1"):
        ocp.save_problem(reach(0.4), tmp_path / "problem.toml", n_starts=0)
    with pytest.raises(TypeError, match=r"^tracked is 'False': give True or False"):
        ocp.save_problem(reach(0.4), tmp_path / "problem.toml", tracked="False")
    with pytest.raises(TypeError, match="'method': give transcription"):
        ocp.save_problem(reach(0.4), tmp_path / "problem.toml", method=1)
    with pytest.raises(TypeError, match=r"ocp\.Problem"):
        ocp.save_problem(reach(0.4).model, tmp_path / "problem.toml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["prism", "d-bar", "six-bar-ball", "reach"])
def test_the_files_to_start_from_are_planned(name):
    plan = ocp.solve(**ocp.load_solve_arguments(f"{FOLDER}/{name}.toml"))
    assert plan.success, plan.message


def test_names_groups_and_shapes_stand_for_numbers(written):
    path = written(
        ARM
        + """
        [numbers]
        side = 0.4
        [plan]
        duration = [0.5, "2 * side"]
        goals = [
            { kind = "NodePositions", positions = { tip = ["side", "free", "free"] } },
            "AtRest", { kind = "StringLengths", lengths = { guys = 1.3 } },
        ]
        bounds = [{ kind = "ForceDensityLimits", upper = [10, 20, inf, 30] }]
        costs = [{ kind = "Tracking", positions = { tip = ["side * t", "free", 0] } }]
        """
    )
    problem = ocp.load_problem(path)
    assert (problem.shortest, problem.longest) == (0.5, 0.8)
    place, _, lengths = problem.goals
    assert place.positions == {1: (0.4, None, None)}
    assert lengths.lengths == {0: 1.3, 1: 1.3, 2: 1.3, 3: 1.3}
    assert problem.force_density_limits[1].tolist() == [10, 20, np.inf, 30]
    assert [
        float(entry) if entry is not None else None for entry in problem.costs[0].positions[1](2.0)
    ] == [0.8, None, 0.0]
    prism = '[structure]\nshape = "prism"\n[plan]\nbounds = [{ kind = "ForceDensityLimits", upper = 100 }]\n'
    shaped = ocp.load_problem(
        written(
            prism + 'goals = [{ kind = "Shape", nodes = { shape = "prism", radius = 0.5 } }]',
            "shape.toml",
        )
    )
    assert np.array_equal(shaped.goals[0].nodes, tc.shapes.prism(radius=0.5).nodes)


def test_groups_of_controls_are_those_of_cables(written):
    cables = """
    [structure]
    nodes = { a = [-1, 0, 1], eye = [0, 0, 0], b = [1, 0, 1], c = [0, 1, 0], d = [0, -1, 0] }
    node_mass = { eye = 1.0 }
    pinned = ["a", "b", "c", "d"]
    strings = { run = [["a", "eye"], ["eye", "b"]], left = [["eye", "c"]], right = [["eye", "d"]] }
    cables = [["run"]]
    [scene]
    control = "RestLength"
    [plan]
    costs = ["Effort"]
    duration = 1.0
    goals = ["AtRest"]
    transcription = { kind = "MultipleShooting", intervals = 5, control = { kind = "PiecewiseConstant", groups = [["run"], ["left", "right"]] } }
    """
    way = ocp.load_solve_arguments(written(cables))
    assert way["transcription"].control.groups == ((0,), (1, 2))


def test_the_start_is_that_of_the_scene_unless_the_plan_has_its_own(written):
    moving = (
        ARM
        + "[start]\nvelocities = { tip = [0.5, 0, 0] }\n[plan]\ncosts = ['Effort']\nbounds = ['ForceDensityLimits']\n"
    )
    problem = ocp.load_problem(written(moving))
    assert problem.model.velocities(problem.initial_state)[1].tolist() == [0.5, 0, 0]
    problem = ocp.load_problem(written(moving + "start = 'structure'"))
    assert not problem.model.velocities(problem.initial_state).any()
    assert ocp.load_problem(written(moving + "start = 'FreeStart'")).free_start


WRONG = {  # what stands in [plan]: the key, and words of the message
    "duration = -1": ("plan.duration", "must be"),
    "duration = [2, 1]": ("plan.duration", "shortest, longest"),
    "duration = 'side'": ("plan.duration", "'side' is not declared"),
    "goals = [{ kind = 'AtREst' }]": ("plan.goals[0].kind", "did you mean 'AtRest'?"),
    "goals = ['AtRest', { kind = 'NodePositions', positions = { top = [0, 0, 1] } }]": (
        "plan.goals[1].positions.top",
        "did you mean 'tip'?",
    ),
    "goals = [{ kind = 'NodePositions', positions = { 9 = [0, 0, 1] } }]": (
        "plan.goals[0].positions.9",
        "run from 0 to 5",
    ),
    "goals = [{ kind = 'NodePositions', positions = { west = [0, 0, 1] } }]": (
        "plan.goals[0]",
        "leave that axis None",
    ),
    "goals = [{ kind = 'StringLengths', lengths = [1, 2] }]": ("plan.goals[0]", "give"),
    "goals = [{ kind = 'StringLengths', lengths = { shape = 'prisn' } }]": (
        "plan.goals[0].lengths.shape",
        "did you mean 'prism'?",
    ),
    "goals = [{ kind = 'Waypoint', goals = ['AtRest'] }]": ("plan.goals[0]", "give one of them"),
    "goals = 'AtRest'": ("plan.goals", "give a list"),
    "bounds = [{ kind = 'ForceDensityLimits', lower = 5, upper = 1 }]": (
        "plan.bounds[0]",
        "give lower",
    ),
    "bounds = [{ kind = 'Obstacle', centre = [0, 0], radius = 1 }]": (
        "plan.bounds[0].centre",
        "3 numbers",
    ),
    "bounds = [{ kind = 'Wall', name = 'x' }]": ("plan.bounds[0].kind", "give one of"),
    "costs = [{ kind = 'Effort', weight = 0 }]": ("plan.costs[0].weight", "must be"),
    "costs = [{ kind = 'Effort', wight = 1 }]": ("plan.costs[0].wight", "did you mean 'weight'?"),
    "phases = [{ duration = 1, stands = [1] }]": ("plan.phases", "ground"),
    "start = 'here'": ("plan.start", "give"),
    "start = [[0, 0, 0]]": ("plan.start", "give"),
    "control = 'Thrust'": ("plan.control", "ForceDensity"),
    "transcription = { kind = 'Variational', intervals = 2.5 }": (
        "plan.transcription.intervals",
        "whole number",
    ),
    "transcription = { kind = 'Variational', intervals = 1000000000 }": (
        "plan.transcription.intervals",
        "must be",
    ),
    "solver = { kind = 'Ipopt', options = { hsllib = 'evil.so' } }": (
        "plan.solver.options.hsllib",
        "leave it out",
    ),
    "solver = { kind = 'Ipopt', options = { output_file = 'out' } }": (
        "plan.solver.options.output_file",
        "leave it out",
    ),
    "solver = { kind = 'Ipopt', options = { ma97_dump_matrix = 'yes' } }": (
        "plan.solver.options.ma97_dump_matrix",
        "leave it out",
    ),
    "solver = { kind = 'Ipopt', callback = 1 }": ("plan.solver.callback", "is no field"),
    "n_starts = 1e9": ("plan.n_starts", "must be"),
    "tolerance = 0": ("plan.tolerance", "must be"),
    "time_limit = -3": ("plan.time_limit", "must be"),
    "tracked = 1": ("plan.tracked", "true or false"),
    "kind = 'Effort'": ("plan.kind", "is no field of plan"),
    "gaols = []": ("plan.gaols", "did you mean 'goals'?"),
}


@pytest.mark.parametrize("line", WRONG)
def test_what_is_wrong_is_told_with_its_line_and_key(line, written):
    key, cure = WRONG[line]
    path = written(f"{ARM}\n[plan]\n# the next line is the 12th\n{line}\n")
    with pytest.raises(tc.SceneFileError) as caught:
        ocp.load_solve_arguments(path)
    assert (caught.value.key, caught.value.line) == (key, 12)
    assert cure in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_a_plan_is_refused(written):
    with pytest.raises(tc.SceneFileError, match=r"scene\.toml: it has no \[plan\]: give one"):
        ocp.load_problem(written(ARM))
