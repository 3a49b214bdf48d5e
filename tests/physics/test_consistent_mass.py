"""Consistent masses of strings: m/6 [[2, 1], [1, 2]] of each segment."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import tenscasadi as tc


def rod(**options: object) -> tc.Structure:
    """A string of 1 kg and 1 N/m along x, whose free end moves along it."""
    return tc.Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        string_mass=1.0,
        stiffness=1.0,
        pinned={0: "xyz", 1: "yz"},
        **options,
    )


def test_mass_matrix_of_one_string():
    M = tc.Scene(rod(), ends="consistent").modelled.mass_matrix().toarray()
    np.testing.assert_allclose(M, [[1 / 3, 1 / 6], [1 / 6, 1 / 3]], rtol=1e-15)


def test_mass_matrix_of_segments():
    scene = tc.Scene(rod(), segments=2, ends="consistent")
    M = scene.modelled.mass_matrix().toarray()
    expected = np.array([[2, 0, 1], [0, 2, 1], [1, 1, 4]]) / 12
    np.testing.assert_allclose(M, expected, rtol=1e-15)
    assert M.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("ends", ["lumped", "consistent"])
def test_frequency_converges_from_above_or_below(ends):
    """A fixed-free rod: ω = π/2 √(k/m); with consistent masses it is an upper bound."""
    errors = []
    for segments in (4, 8, 16):
        model = tc.Model(tc.Scene(rod(), segments=segments, ends=ends, slack=tc.Linear()))
        frequency = tc.modes(model).frequency
        errors.append(frequency[frequency > 1e-3][0] * 4 - 1)  # ω/2π = 1/4
    assert np.all(np.sign(errors) == (1 if ends == "consistent" else -1))
    for coarse, fine in itertools.pairwise(errors):
        assert coarse / fine == pytest.approx(4.0, rel=0.02)  # second order


def test_energy_is_conserved():
    s = tc.shapes.prism(string_mass=0.5, prestress=10.0, pinned=[0])
    scene = tc.Scene(s, segments=2, ends="consistent", gravity=tc.Gravity())
    run = tc.simulate(tc.Model(scene), 0.3, 5e-4)
    assert run.success, run.message
    assert np.abs(run.energy_error).max() < 1e-7


def test_weights_are_those_of_lumped_masses():
    s = tc.shapes.prism(string_mass=0.5, prestress=30.0, pinned=[0, 1, 2])
    nodes = [
        tc.find_equilibrium(tc.Scene(s, ends=ends, gravity=tc.Gravity())).nodes
        for ends in ("lumped", "consistent")
    ]
    np.testing.assert_allclose(*nodes, atol=1e-12)


def test_string_mass_as_a_parameter():
    scene = tc.Scene(rod(), segments=3, ends="consistent", parameters=tc.Parameters("string_mass"))
    model = tc.Model(scene)
    fixed = model.with_parameters({"string_mass": 5.0})
    nodes = model.structure.nodes.copy()
    nodes[1:, 0] += [0.3, -0.1, 0.2]
    x = model.state(nodes)
    np.testing.assert_allclose(
        model.ode(x, [], [5.0]).full(), fixed.ode(x, []).full(), rtol=1e-12, atol=1e-14
    )


def test_full_coordinates_and_mujoco_are_rejected(tmp_path):
    scene = tc.Scene(tc.shapes.prism(string_mass=0.5), ends="consistent")
    assert tc.Model(scene).coordinates == "reduced"
    with pytest.raises(ValueError, match='give "reduced"'):
        tc.Model(scene, coordinates="full")
    with pytest.raises(ValueError, match="consistent"):
        tc.export_mjcf(scene, tmp_path / "x.xml")


def test_files_keep_it(tmp_path):
    scene = tc.Scene(tc.shapes.prism(string_mass=0.5), ends="consistent")
    tc.save_scene(scene, tmp_path / "prism.toml")
    again = tc.load_scene(tmp_path / "prism.toml")
    assert again.ends == "consistent"
    np.testing.assert_array_equal(
        again.modelled.mass_matrix().toarray(), scene.modelled.mass_matrix().toarray()
    )
    run = tc.simulate(tc.Model(scene), 0.01, 1e-3, compiled=False)
    run.save(tmp_path / "run.npz")
    assert tc.Trajectory.load(tmp_path / "run.npz").scene.ends == "consistent"
