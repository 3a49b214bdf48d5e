"""Instants: lengths, rates and rest lengths of expressions and of numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven, prism
from rising import MODEL

from ocp.problem.instant import Instant


def test_instants_are_numbers_too():
    now = Instant(MODEL, ca.MX(MODEL.initial_state), ca.MX(np.ones(9)), 0)
    assert ca.evalf(now.lengths).full().ravel() == pytest.approx(MODEL.structure.string_lengths)
    assert np.abs(ca.evalf(now.rates).full()).max() == 0.0


def test_segments_add_up_to_a_rest_length():
    model = driven(prism(1.0, string_mass=0.1), segments=2)
    now = Instant(model, ca.MX(model.initial_state), ca.MX(np.full(9, 5.0)), 0)
    rest = ca.evalf(now.rest_lengths(np.full(9, 500.0))).full().ravel()
    assert rest == pytest.approx(model.scene.structure.string_lengths * (1 - 5.0 / 500.0))
