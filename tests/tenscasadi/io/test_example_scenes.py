"""The scenes of examples/scenes are those of the scripts, of the README, and in balance where they say so; all run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loading import load_example

import tenscasadi as tc

FOLDER = Path(__file__).parents[3] / "examples/scenes"
PATHS = sorted(FOLDER.glob("*.toml"))


def load(name: str, **changes: object) -> tc.Simulation:
    return replace(tc.load_simulation(FOLDER / f"{name}.toml"), **changes)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_every_scene_runs(path):
    simulation = tc.load_simulation(path)
    steps = 50 * (simulation.step or 1e-3)
    run = replace(simulation, t_end=steps).run(compiled=False)
    assert run.success, run.message
    assert run.bar_length_error.max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_every_scene_runs_to_its_end(path):
    run = tc.load_simulation(path).run()
    assert run.success, run.message
    assert run.bar_length_error.max() < 1e-6


def paper_prism() -> tuple[tc.Scene, str]:
    return tc.Scene(load_example("paper_prism").prism(), segments=5), None


def paper_dbar() -> tuple[tc.Scene, str]:
    return tc.Scene(load_example("paper_dbar").d_bar()), "full"


def paper_lander() -> tuple[tc.Scene, str]:
    return tc.Scene(
        load_example("paper_lander").ball(),
        segments=2,
        gravity=tc.Gravity(),
        ground=tc.Ground(stiffness=1e4, damping=10.0),
    ), None


def paper_membrane() -> tuple[tc.Scene, str]:
    paper = load_example("paper_membrane")
    pressure = tc.Pressure(tc.shapes.membrane_faces(8, 5).tolist(), paper.RISE * paper.ATMOSPHERE)
    return tc.Scene(
        paper.membrane(8, 5),
        ends="lumped",
        pressure=pressure,
        forces=tc.NodalForce(paper.RISE * paper.caps(8, 5)),
    ), None


@pytest.mark.parametrize(
    ("scene", "t_end", "moves"),
    [
        (paper_prism, 0.5, 0.1),
        (paper_dbar, 1.0, 0.5),
        (paper_lander, 0.3, 0.4),
        (paper_membrane, 0.02, 0.04),
    ],
)
def test_scenes_of_the_paper_move_as_its_scripts_do(scene, t_end, moves):
    read = load(scene.__name__, t_end=t_end)
    expected, coordinates = scene()
    script = load_example(scene.__name__)
    assert (read.step, read.coordinates) == (script.STEP, coordinates)
    ours = read.run(compiled=False)
    correction = None if scene is paper_membrane else tc.Projection()
    theirs = tc.simulate(
        tc.Model(expected, coordinates),
        t_end,
        script.STEP,
        correction=correction,
        save_every=read.save_every,
        compiled=False,
    )
    assert ours.success
    assert np.abs(theirs.nodes[-1] - theirs.nodes[0]).max() > moves
    np.testing.assert_allclose(
        ours.nodes, theirs.nodes, atol=1e-9 * np.ptp(expected.structure.nodes)
    )
    assert load(scene.__name__).t_end == script.T_END


def test_the_mast_is_that_of_the_readme():
    mast = tc.Structure([(0, 0, 0), (0, 0, 2), (1, 0, 0), (-0.5, 0.87, 0), (-0.5, -0.87, 0)], bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4)],
                        bar_mass=3.0, stiffness=500.0, pinned=[0, 2, 3, 4])  # fmt: skip
    wind = np.zeros((5, 3))
    wind[1] = (15, 5, 0)
    mast = mast.prestressed(tc.equilibrium_force_density(mast, loads=wind, minimum=10.0))
    found = load("mast").scene
    for name in ("nodes", "bars", "strings", "bar_mass", "stiffness", "fixed", "rest_length"):
        np.testing.assert_allclose(getattr(found.structure, name), getattr(mast, name), rtol=1e-12)
    np.testing.assert_array_equal(found.forces.values, wind)


def test_the_tower_is_of_class_2_and_in_balance_without_gravity():
    tower = load("tower").scene.structure
    ends = np.bincount(tower.bars.ravel())
    assert ends.tolist() == [1, 1, 1, 2, 2, 2, 1, 1, 1]
    still = tc.Model(tc.Scene(tower))
    acceleration = still.ode(still.initial_state, []).full().ravel()[still.nq :]
    gamma = tower.stiffness * (1 - tower.rest_length / tower.string_lengths)
    assert gamma.min() == pytest.approx(200.0)
    assert np.abs(acceleration).max() < 1e-10 * gamma.max() / tower.bar_mass.min()


def test_the_d_bar_spins_about_its_pin():
    found = load("dbar")
    velocities = found.model.velocities(found.start)
    np.testing.assert_allclose(
        velocities,
        np.cross([0, 0, 3.0], found.scene.structure.nodes - found.scene.structure.nodes[0]),
        atol=1e-15,
    )
