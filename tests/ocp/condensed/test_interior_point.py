"""The interior-point method: what becomes of rows whose barriers are infinite."""

from __future__ import annotations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.condensed.interior_point import Search, point_at
from ocp.condensed.motions import first_motion
from ocp.condensed.path_rows import Limited
from ocp.condensed.reduced import ReducedProblem
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.initial_guess import evaluate_guess
from tests.ocp.condensed.test_reduced import LIMITS, RISE, driven


def test_rows_with_infinite_barriers_do_not_count_among_those_that_are_met():
    """Their stiffness overflows where slacks come near to limits; steps then keep them where they are, and all others stay in order."""
    problem = ocp.Problem(
        driven(tc.shapes.prism()),
        goals=RISE,
        bounds=[LIMITS, ocp.TensionLimits(upper=300.0)],
        costs=[ocp.Effort()],
    )
    transcription, scales = ocp.Variational(5), Scales.of(problem)
    target = find_target(problem, scales)
    guess = evaluate_guess(None, problem, target, transcription.count)
    reduced = ReducedProblem(
        problem,
        transcription,
        target,
        scales,
        2.0,
        10.0,
        Limited(problem, transcription, target, scales, guess),
    )
    w = 0.6 + 0.1 * np.random.default_rng(0).uniform(size=reduced.size)
    search = Search(
        reduced,
        w,
        first_motion(reduced.chain, reduced.strings(w), reduced.split(w)[1], guess.states),
        1e-6,
    )
    met, row = len(search.multipliers), search.chosen[0]
    near, point = search.point.slack.copy(), search.point
    near[row] = reduced.paths.limits.upper[row] - 0.5
    search.of_paths.upper[row] = np.finfo(float).max
    with np.errstate(all="ignore"):  # as in all of the method
        search._stand(point_at(reduced, point.w, point.motion, near))
        assert np.isinf(search.path_stiffness[row])
        assert search.projector.count == met
        asked = np.ones(len(search.rows))
        step = search.projector.shortest(asked)
    kept = [*range(met), met + int(np.flatnonzero(search.chosen == row)[0])]
    assert search.rows[kept] @ step == pytest.approx(asked[kept], abs=1e-6)
    assert len(search.projector.multipliers(search.slope)) == met
