"""Shapes and scene files by name: what is simulated, planned and written."""

from __future__ import annotations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi.cli.main import main
from tenscasadi.cli.source import TEMPLATES, find_source
from tenscasadi.io.document import Change


def run(*arguments):
    return main([str(argument) for argument in arguments])


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def new(name, path, capsys):
    assert run("new", name) == 0
    path.write_text(capsys.readouterr().out, encoding="utf-8")


@pytest.mark.parametrize("name", TEMPLATES)
def test_new_writes_a_file_that_is_the_template(name, here, capsys):
    new(name, here / "my.toml", capsys)
    ours, theirs = find_source("my.toml"), find_source(name)
    assert repr(ours.scene()) == repr(theirs.scene())
    if ours.has("simulation"):
        assert np.array_equal(ours.simulation().start, theirs.simulation().start)


def test_the_starts_are_those_that_help_tells():
    spun = find_source("d-bar").simulation()
    nodes, moved = spun.scene.structure.nodes, spun.model.velocities(spun.start)
    assert moved == pytest.approx(np.cross((0, 0, 3.0), nodes - nodes[0]), abs=1e-12)
    ball = find_source("six-bar-ball").simulation()
    middle = ball.model.structure.nodes.mean(axis=0)
    thrown = np.array([3.0, 0.0, 5.0]) + np.cross(
        (1.0, 3.0, 0.5), ball.model.structure.nodes - middle
    )
    assert ball.model.velocities(ball.start) == pytest.approx(thrown, abs=1e-12)
    prism = find_source("prism").simulation()
    nodes = prism.model.structure.nodes
    turned = np.cross((0, 0, 4.0), nodes) * np.sign(nodes[:, 2:] - 0.5)
    assert prism.model.velocities(prism.start).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.sum(prism.model.velocities(prism.start) * turned) == pytest.approx(
        np.sum(turned**2), rel=0.5
    )  # nearest that keep the bars
    bent = find_source("double-pendulum").scene().structure.nodes
    assert bent == pytest.approx(tc.shapes.double_pendulum(angles=(np.pi / 2, 2 * np.pi / 3)).nodes)


def test_changes_go_before_the_file(here, capsys):
    new("six-bar-ball", here / "ball.toml", capsys)
    changes = {
        "simulation.t_end": "0.3",
        "simulation.coordinates": "full",
        "simulation.scheme": "Rattle",
        "scene.gravity": "[0, 0, -1.5]",
        "numbers.half": "'1 / 4'",
    }
    source = find_source("ball.toml", [Change("--set", *pair) for pair in changes.items()])
    found = source.simulation()
    assert (found.t_end, found.step, found.coordinates) == (0.3, 1e-3, "full")
    assert found.scheme == tc.Rattle()
    assert found.scene.gravity == tc.Gravity((0.0, 0.0, -1.5))
    assert found.scene.structure.bar_lengths == pytest.approx(np.full(6, 0.5))


@pytest.mark.slow
def test_a_new_user(here, capsys):
    new("prism", here / "p.toml", capsys)
    assert run("plan", "p.toml") == 0
    assert "goals: StringLengths, AtRest" in capsys.readouterr().out
    assert {path.name for path in here.iterdir()} == {
        "p.toml",
        "p-plan.npz",
        "p-plan.png",
        "p-plan-forces.png",
    }
    plan = ocp.Plan.load("p-plan.npz")
    assert plan.success
    assert plan.replay().nodes[-1, 3:, 2].mean() - plan.replay().nodes[
        -1, :3, 2
    ].mean() == pytest.approx(1.1, abs=1e-3)
    assert run("simulate", "p.toml", "--t-end", 0.05, "--uncompiled") == 0
    assert tc.Trajectory.load("p-simulation.npz").time[-1] == 0.05
    assert (
        run("tradeoff", "p.toml", "--t-end", 0.05, "--steps", 0.01, "--rtol", 1e-4, "--uncompiled")
        == 0
    )
    assert len(tc.Tradeoff.load("p-tradeoff.npz").rows) == 10
    capsys.readouterr()
    assert run("info", "p.toml") == 0
    out = capsys.readouterr().out
    assert "2 s in steps of 0.001 s by RungeKutta4()" in out
    assert "1 s, goals: StringLengths, AtRest; bounds: ForceDensityLimits; costs: Effort" in out


def test_files_without_their_part_say_so(here, capsys):
    (here / "bare.toml").write_text('format = 1\nunits = "SI"\n[structure]\nshape = "prism"\n')
    for command, part in {
        "simulate": "simulation",
        "tradeoff": "simulation",
        "plan": "plan",
    }.items():
        assert run(command, "bare.toml") == 2
        assert capsys.readouterr().err.startswith(
            f"tenscasadi: bare.toml: it has no [{part}]: give"
        )
    assert run("info", "bare.toml") == 0


def test_invalid_plans_give_one_line(here, capsys):
    new("reach", here / "reach.toml", capsys)
    text = (here / "reach.toml").read_text()
    (here / "far.toml").write_text(text.replace("side = 0.4", "side = 4.0"))
    assert run("plan", "far.toml") == 2
    error = capsys.readouterr().err
    assert error.startswith("tenscasadi: far.toml, plan: ")
    assert error.count("\n") == 1
    assert not list(here.glob("*.npz"))


def test_message_omits_terminal_codes(here, capsys):
    (here / "odd.toml").write_text(
        'format = 1\nunits = "SI"\n[structure]\nshape = "\\u001b[31mprism"\n'
    )
    assert run("info", "odd.toml") == 2
    error = capsys.readouterr().err
    assert error.rstrip("\n").isprintable()


def test_there_are_ten_templates_or_more():
    assert len(TEMPLATES) >= 16


@pytest.mark.parametrize("name", ["jump", "swing-up", "net", "dome", "tower", "crawling"])
def test_template_simulates_and_plans_are_read(name):
    source = find_source(name)
    simulation = source.simulation()
    run = tc.simulate(
        simulation.model, 0.05, 1e-3, control=simulation.control, compiled=False, verify=False
    )
    assert run.success, run.message
    if "[plan]" in source.path.read_text(encoding="utf-8"):
        problem = ocp.load_problem(source.path)
        assert problem.goals or problem.phases


def test_swing_up_template_has_a_plan():
    path = find_source("swing-up").path
    plan = ocp.solve(ocp.load_problem(path))
    assert plan.success, plan.message
    tip = plan.replay().nodes[:, 1, 2]
    assert tip[0] < -0.99
    assert tip[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("name", ["d-bar-column", "sweep", "identification"])
def test_templates_without_plan_simulate_well(name):
    run = find_source(name).simulation().run(compiled=False)
    assert run.success
    assert run.message.startswith("finished")
    assert "; " not in run.message  # no doubts
    assert np.ptp(run.nodes, axis=0).max() > 5e-3


def test_mpc_template_reaches_its_target_with_another_mass(here, capsys):
    assert run("control", "mpc", "--mass", 1.2, "--no-plots") == 0
    motion = tc.Trajectory.load("mpc-control.npz")
    assert motion.scene.structure.bar_mass.tolist() == [1.2]
    assert motion.nodes[-1, 1, :2] == pytest.approx([0.4, 0.2], abs=0.03)


@pytest.mark.parametrize("name", ["mast.xml", "mast.YAML", "mast.mat"])
def test_files_of_other_programs_name_the_import(name):
    with pytest.raises(ValueError, match=f"convert it by tenscasadi import {name} scene.toml"):
        find_source(name)
