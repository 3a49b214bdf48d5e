"""Refinement, robustness and closed loop in scene files: what they read, reject and run."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.io.controllers import ControllerOptions, MpcOptions, TrackOptions
from ocp.io.problem_files import read_arguments
from ocp.io.study_sections import describe_studies, measure_goal_error, read_studies
from tenscasadi.io.document import read_document

ARM = """
format = 1
units = "SI"
[structure]
nodes = { hinge = [0, 0, 0], tip = [0, 0, 1], west = [-1, 0, 0], east = [1, 0, 0], south = [0, -1, 0], north = [0, 1, 0] }
bars = [["hinge", "tip"]]
strings = [["tip", "west"], ["tip", "east"], ["tip", "south"], ["tip", "north"]]
pinned = ["hinge", "west", "east", "south", "north"]
[scene]
parameters = { names = ["bar_mass"], groups = { bar_mass = "all" } }
[plan]
goals = [{ kind = "NodePositions", positions = { tip = [0.4, 0.2, "free"] } }, "AtRest"]
bounds = [{ kind = "ForceDensityLimits", lower = 0.0, upper = 50.0 }]
costs = ["Effort"]
transcription = { kind = "MultipleShooting", intervals = 10 }
"""
FUNCTIONS = {"Mpc": ocp.Mpc, "Mppi": ocp.Mppi, "Track": ocp.track}


@pytest.fixture
def read(tmp_path):
    def read_text(text):
        (tmp_path / "arm.toml").write_text(ARM + text, encoding="utf-8")
        return read_document(tmp_path / "arm.toml")

    return read_text


@pytest.mark.parametrize("kind", FUNCTIONS)
def test_options_have_the_defaults_of_the_controller(kind):
    known = inspect.signature(FUNCTIONS[kind]).parameters
    own = inspect.signature(ControllerOptions.members[kind]).parameters
    assert len(own) >= 3
    for name, parameter in own.items():
        if name != "along_plan":
            assert known[name].default == parameter.default, name


def test_files_without_tables_have_no_studies(read):
    assert read_studies(read("")) == (None, None, None)
    assert describe_studies(read_studies(read(""))) == []


def test_tables_are_read(read):
    found = read_studies(
        read(
            "[refinement]\ntolerance = '1e-4 / 2'\n"
            "[robustness]\nparameters = { bar_mass = 0.05 }\nstart = [1e-3, 0.01]\nsamples = 50\n"
            "[closed_loop]\nt_end = 2\ncontroller = 'Track'\nparameters = { bar_mass = 1.1 }\n"
        )
    )
    assert (found.refinement.tolerance, found.refinement.attempts) == (5e-5, 5)
    assert found.robustness.parameters == {"bar_mass": 0.05}
    assert tuple(found.robustness.start) == (1e-3, 0.01)
    assert found.closed_loop.controller == TrackOptions()
    lines = describe_studies(found)
    assert [line.split()[0] for line in lines] == ["refinement", "robustness", "closed_loop"]
    assert "samples = 50" in lines[1]
    assert "seed" not in lines[1]  # a default


def test_the_default_controller_is_predictive(read):
    assert read_studies(read("[closed_loop]\nt_end = 1")).closed_loop.controller == MpcOptions()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[refinement]", "refinement has no tolerance"),
        ("[refinement]\ntolerance = 0", "tolerance is 0"),
        ("[refinement]\ntolerance = 1\nattempts = 0", "attempts is 0"),
        ("[robustness]", "nothing|give something that varies"),
        ("[robustness]\nparameters = { bar_mas = 0.1 }", "bar_mas"),
        ("[robustness]\nparameters = { bar_mass = 1.5 }", "less than 1"),
        ("[robustness]\nstart = -1", "start is -1"),
        ("[robustness]\nstart = 1\nsamples = 0", ": samples is 0"),
        ("[closed_loop]", "closed_loop has no t_end"),
        ("[closed_loop]\nt_end = 1\ncontroller = 'Mpcc'", "did you mean 'Mpc'"),
        ("[closed_loop]\nt_end = 1\ncontroller = { perod = 1 }", "did you mean 'period'"),
        ("[closed_loop]\nt_end = 1\nsteps = 0", ": steps is 0"),
    ],
)
def test_bad_tables_are_rejected_by_line(text, message, read):
    with pytest.raises(tc.SceneFileError, match=message) as caught:
        read_studies(read(text))
    assert caught.value.line is not None


@pytest.mark.parametrize(
    ("controller", "error"),
    [
        ("{ intervals = 5, period = 0.1 }", 0.01),
        ("{ kind = 'Mppi', horizon = 0.3, period = 0.1, samples = 16 }", 0.2),
        ("{ kind = 'Track', decisions = 20 }", 0.05),
        ("{ along_plan = true, intervals = 5, period = 0.1 }", 0.01),
    ],
)
def test_controllers_reach_the_goals_of_a_heavier_scene(controller, error, read):
    document = read(
        f"[closed_loop]\nt_end = 1.5\ncontroller = {controller}\nparameters.bar_mass = 1.1"
    )
    arguments, solved = read_arguments(document), []

    def find_plan():
        solved.append(ocp.solve(**arguments))
        return solved[-1]

    loop = read_studies(document).closed_loop.run(arguments["problem"], find_plan)
    assert loop.trajectory.success
    assert loop.trajectory.time[-1] == pytest.approx(1.5)
    assert loop.trajectory.scene.structure.bar_mass.tolist() == [1.1]
    position, velocity = measure_goal_error(arguments["problem"], loop.trajectory.states[-1])
    tip = loop.trajectory.nodes[-1, 1]
    assert position == pytest.approx(np.abs(tip[:2] - [0.4, 0.2]).max(), abs=1e-9)
    assert position < error
    assert velocity < 2.0
    assert len(solved) == ("Track" in controller or "along_plan" in controller)


@pytest.mark.parametrize("parameters", ["", "parameters.bar_mass = 1.1"], ids=["plan", "own"])
def test_strings_of_the_simulated_scene_break(parameters, read):
    table = f"[closed_loop]\nt_end = 1.0\ncontroller = 'Track'\n{parameters}\n"
    strong = ocp.solve(**read_arguments(read(table)))
    force = 0.9 * strong.tension().max()
    document = read(f"{table}[scene.strength]\nforce = {force}\n")
    problem = read_arguments(document)["problem"]
    run = read_studies(document).closed_loop.run(problem, lambda: strong).trajectory
    assert run.success, run.message
    assert run.breaks
    assert run.scene.structure.bar_mass.tolist() == [1.1 if parameters else 1.0]
    position, velocity = measure_goal_error(problem, run.states[-1])
    assert position == pytest.approx(np.abs(run.nodes[-1, 1, :2] - [0.4, 0.2]).max(), abs=1e-9)
    assert np.isfinite(velocity)


def test_refinement_and_robustness_take_the_plan(read):
    document = read("[refinement]\ntolerance = 1e-6\n[robustness]\nstart = 1e-3\nsamples = 20")
    plan = ocp.solve(**read_arguments(document))
    studies = read_studies(document)
    refined = studies.refinement.run(plan)
    assert refined.replay_error < 1e-6 < plan.replay_error
    found = studies.robustness.run(refined)
    assert len(found.error) == 20
    assert found.error.max() > refined.replay_error


STUDIES = {
    "refinement": {"tolerance": 1e-4, "attempts": 2},
    "robustness": {"parameters": {"bar_mass": 0.05}, "start": (1e-3, 0.01), "samples": 50},
    "closed_loop": {"t_end": 2.0, "controller": {"kind": "Mpc", "period": 0.1}, "steps": 5},
}


def test_saved_studies_come_back(read, tmp_path):
    problem = read_arguments(read(""))["problem"]
    path = ocp.save_problem(problem, tmp_path / "saved.toml", studies=STUDIES)
    found = ocp.load_studies(path)
    assert found["refinement"] == STUDIES["refinement"]
    assert found["robustness"]["parameters"] == {"bar_mass": 0.05}
    assert tuple(found["robustness"]["start"]) == (1e-3, 0.01)
    assert found["closed_loop"]["controller"] == MpcOptions(period=0.1)
    again = ocp.save_problem(problem, tmp_path / "again.toml", studies=found)
    assert again.read_text() == path.read_text()
    assert ocp.load_studies(ocp.save_problem(problem, tmp_path / "none.toml")) == {}
    controller = found["closed_loop"]["controller"].build(problem, None)
    assert controller.period == 0.1


def test_the_kind_of_a_controller_suffices(read, tmp_path):
    problem = read_arguments(read(""))["problem"]
    studies = {"closed_loop": {"t_end": 1.0, "controller": "Track"}}
    path = ocp.save_problem(problem, tmp_path / "saved.toml", studies=studies)
    assert ocp.load_studies(path)["closed_loop"]["controller"] == TrackOptions()


@pytest.mark.parametrize(
    ("studies", "message"),
    [
        (3, "studies is 3: give mappings by name, refinement, robustness, closed_loop"),
        ({"refine": {}}, "studies has 'refine': give some of refinement"),
        ({"refinement": 1e-3}, "give mappings by name"),
        ({"refinement": {}}, "studies.*refinement has no tolerance"),
        ({"refinement": {"tolerance": -1.0}}, "studies.*tolerance is -1"),
        ({"refinement": {"tolerance": np.nan}}, "studies.*tolerance.*nan"),
        ({"refinement": {"tolerance": 10**400}}, "studies.*tolerance"),
        ({"refinement": {"tolerance": object()}}, "studies is .*: give numbers, texts, lists"),
        ({"refinement": {"tol": 1.0}}, "studies.*is no field of refinement"),
        ({"closed_loop": {"t_end": 1.0, "controller": "Mpcc"}}, "did you mean 'Mpc'"),
        ({"closed_loop": {"t_end": 1.0, "controller": {"perod": 1}}}, "did you mean 'period'"),
        ({"closed_loop": {"t_end": 1.0, "parameters": 3}}, "studies.*parameters"),
    ],
)
def test_wrong_studies_are_rejected_by_name(studies, message, read, tmp_path):
    problem = read_arguments(read(""))["problem"]
    with pytest.raises((TypeError, ValueError), match=message):
        ocp.save_problem(problem, tmp_path / "saved.toml", studies=studies)
