"""Triangular iteration: Crout's factors, sweeps that diverge."""

from __future__ import annotations

import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.stage_iteration import factor_crout
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes


def test_crout() -> None:
    A = np.random.default_rng(1).normal(size=(4, 4)) + 4 * np.eye(4)
    L = factor_crout(A)
    U = np.linalg.solve(L, A)
    assert np.triu(L, 1) == pytest.approx(np.zeros((4, 4)))
    assert np.tril(U) == pytest.approx(np.eye(4), abs=1e-12)


def test_diverging_sweeps_print_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    prism = shapes.prism(stiffness=500.0, prestress=40.0)
    raised = prism.replace(nodes=prism.nodes + [0, 0, 0.5])
    model = Model(Scene(raised, gravity=Gravity(), ground=Ground(1e4, 10.0)))
    run = simulate(model, 1.0, 0.05, Collocation(2), compiled=False, verify=False)
    assert "energy is off" in run.message
    assert not capfd.readouterr().err
