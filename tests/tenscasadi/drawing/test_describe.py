"""Content of pictures of structures, scenes and motions."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.drawing.describe import (
    MOST_COPIES,
    describe_content,
    describe_rollouts,
    describe_structure,
)

PRISM = tc.shapes.prism(stiffness=1000.0, prestress=50.0)


def test_a_structure_has_the_forces_of_its_rest_lengths():
    motion, model = describe_structure(PRISM, "prism"), tc.Model(tc.Scene(PRISM))
    x = model.initial_state
    np.testing.assert_allclose(motion.tension[0], np.ravel(model.tension(x)), rtol=1e-12)
    density = np.ravel(model.force_density(x))
    np.testing.assert_allclose(motion.force_density[0], density, rtol=1e-12)


def test_a_scene_has_the_forces_of_its_string_laws():
    loose = PRISM.replace(rest_length=1.1 * PRISM.string_lengths)
    for slack in (tc.Clip(), tc.Linear(), tc.Smooth(0.1), {0: tc.Linear(), 4: tc.Smooth(0.1)}):
        scene = tc.Scene(loose, slack=slack)
        begun = tc.simulate(tc.Model(scene), 0.002, 0.001, compiled=False)
        shown = describe_content(scene).motions[0]
        for name in ("tension", "force_density"):
            expected = getattr(begun, name)[0]
            np.testing.assert_allclose(getattr(shown, name)[0], expected, rtol=1e-9, atol=1e-9)


def test_rollouts_are_evenly_selected_copies(tmp_path):
    model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    states = np.tile(model.initial_state, (MOST_COPIES + 40, 1))
    many = tc.rollouts(model, 0.1, 0.01, states=states, save_every=5)
    motion = describe_rollouts(many, "many")
    n = len(model.structure.nodes)
    assert motion.copies == MOST_COPIES
    assert motion.name == f"many: {MOST_COPIES} of {MOST_COPIES + 40} motions"
    np.testing.assert_array_equal(motion.bars[2:4] - n, model.structure.bars)
    np.testing.assert_array_equal(motion.nodes[:, n : 2 * n][:, 2], many.path(2)[1])
    saved = tc.Rollouts.load(many.save(tmp_path / "many.npz"))
    np.testing.assert_array_equal(saved.bars, model.structure.bars)


def test_superimposed_motions_have_different_names():
    pair = describe_content([PRISM, PRISM]).motions
    assert [motion.name for motion in pair] == ["1: structure", "2: structure"]
    named = describe_content({"a": PRISM, "b": tc.Scene(PRISM)}).motions
    assert [motion.name for motion in named] == ["a", "b"]


def test_a_ground_appears_once():
    ground = tc.Ground()
    scene = tc.Scene(PRISM, ground=ground)
    assert describe_content([scene, scene], ground=[ground]).grounds == (ground,)


@pytest.mark.parametrize(
    ("things", "kind"), [(3.0, TypeError), ([], ValueError), ({1: PRISM}, TypeError)]
)
def test_wrong_things_are_named(things, kind):
    with pytest.raises(kind, match="field"):
        describe_content(things, "field")
