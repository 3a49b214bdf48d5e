"""The paper's four examples (Sect. 7): what makes their figures right; tests/test_examples.py draws all of them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest
from loading import load_example

import tenscasadi as tc


@pytest.fixture
def example(request: pytest.FixtureRequest) -> Iterator[ModuleType]:
    """The module of the example that the test names."""
    yield load_example(request.param)
    del sys.modules[request.param]


def of(name: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("example", [name], indirect=True)


# --- 7.1 prism ---


@of("paper_prism")
def test_the_prism_starts_as_the_paper_says(example: ModuleType) -> None:
    s = example.prism()
    np.testing.assert_allclose(s.bar_lengths, np.sqrt(2))
    np.testing.assert_allclose(s.string_lengths, 1.0)
    for segments in (1, 5):  # child strings carry their parent's tension
        model = tc.Model(tc.Scene(s, segments=segments))
        np.testing.assert_allclose(model.tension(model.initial_state), 30.0)
    masses = s.subdivide(5).node_mass
    np.testing.assert_allclose(masses, [0] * 6 + [0.01] * 36)  # the paper's point masses of 0.01 kg


@pytest.mark.slow
@of("paper_prism")
def test_mass_on_the_ends_too_makes_segments_converge_faster(example: ModuleType) -> None:
    errors = {}
    for ends in example.ENDS:
        runs = [example.run(n, ends) for n in (2, 4, 8)]
        errors[ends] = [example.distance(run, runs[-1]) for run in runs[:-1]]
    assert errors["lumped"][1] < 0.25 * errors["lumped"][0]  # order 2 in the number of segments
    assert errors["lumped"][1] < 0.8 * errors["interior"][1]


# --- 7.2 D-bar ---


@of("paper_dbar")
@pytest.mark.parametrize("coordinates", ["reduced", pytest.param("full", marks=pytest.mark.slow)])
def test_the_dbar_passes_its_folds(example: ModuleType, coordinates: str) -> None:
    model = tc.Model(tc.Scene(example.d_bar()), coordinates=coordinates)
    errors = []
    for step in (2e-3, 5e-4):
        run = tc.simulate(
            model,
            3.0,
            step,
            correction=tc.Projection(),
            compiled=False,
            save_every=round(1e-2 / step),
        )
        assert run.success, run.message
        assert run.bar_length_error.max() < 1e-14
        assert run.joint_error.max() < 1e-14
        assert not run.nodes[:, :, 2].any()  # exactly in its plane, out of which it is unstable
        assert np.abs(run.nodes[:, 0]).max() < 1e-14  # node 0 stays where it is held
        errors.append(np.abs(run.nodes - example.one_angle(run.time)).max())
    assert run.nodes[:, 2].min() < -0.9  # beyond the fold at 0.66 s
    assert errors[1] < 3e-5
    assert errors[1] < 0.2 * errors[0]


# --- 7.3 membrane ---


@of("paper_membrane")
def test_the_membrane_rests_at_one_atmosphere_and_its_centre_moves_radially(
    example: ModuleType,
) -> None:
    still = example.run(8, 5, rise=1.0)
    assert np.abs(still.nodes - still.nodes[0]).max() < 1e-9
    s = example.membrane(8, 5)
    np.testing.assert_allclose(s.rest_length / s.string_lengths, 0.975)
    area = s.string_mass / (example.DENSITY * s.string_lengths)
    np.testing.assert_allclose(
        still.tension[0] / area, example.STRENGTH
    )  # minimum mass: all strings at their limit

    run = example.run(8, 5)
    middle = example.radial(run, 8, 5)
    k = example.first_peak(middle[:, 0])
    assert middle[k, 0] == pytest.approx(0.0477, abs=5e-5)
    assert run.time[k] == pytest.approx(7e-3, abs=5e-4)
    assert np.ptp(middle, axis=1).max() < 1e-10  # all of its ring alike
    assert np.abs(run.nodes[:, 16:24, 2]).max() < 1e-12
    assert np.ptp(middle[-300:, 0]) < 0.5 * np.ptp(middle[:300, 0])  # damped


# --- 7.4 lander ---


@of("paper_lander")
def test_the_lander_is_in_equilibrium_and_falls_flat(example: ModuleType) -> None:
    s = example.ball()
    np.testing.assert_allclose(s.stiffness * (1 - s.rest_length / s.string_lengths), 1000.0)
    assert np.sum(s.nodes[:, 2] < s.nodes[:, 2].min() + 1e-9) == 3
    run, height = example.drop(s, 0.8)
    falling = run.time < 0.75  # before it lands
    np.testing.assert_allclose(height[falling], 3.5 - 9.81 * run.time[falling] ** 2 / 2, atol=1e-9)
    np.testing.assert_allclose(run.tension[falling], run.tension[0, 0], rtol=1e-6)


@pytest.mark.slow
@of("paper_lander")
def test_the_first_rebound_of_the_lander(example: ModuleType) -> None:
    run, height = example.drop(example.ball(), 1.7)
    assert height[example.rebounds(height)[0]] == pytest.approx(2.304, abs=6e-4)
    assert np.diff(run.energy).max() < 1e-9
    assert run.bar_length_error.max() < 1e-14
