"""Steppers: what stops them, and what they do without a compiler."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from runs import prism

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import DormandPrince54
from tenscasadi.integrators.sundials import Cvodes
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.util.compile import CompileError

G = 9.81


def test_a_run_that_ends_in_its_first_step_has_a_summary() -> None:
    model = Model(Scene(shapes.pendulum(), gravity=Gravity((0, 0, -G))))
    for scheme in (DormandPrince54(1e-13, max_attempts=64), Cvodes(1e-13, max_steps=5)):
        run = simulate(model, 1000.0, 500.0, scheme, compiled=False)
        assert not run.success
        assert len(run.time) == 1
        assert run.step > 0
        assert "0 … 0 s, 0 steps" in run.summary()
        assert "casadi" not in run.message  # no path in the source of CasADi


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    model = prism()
    run = simulate(model, 0.1, 1e-2)
    assert run.success
    assert not run.compiled
    assert "not compiled: no C compiler found: install" in run.message
    with pytest.raises(CompileError, match="no C compiler found"):
        simulate(model, 0.1, 1e-2, compiled=True)
    assert "compiled" not in simulate(model, 0.1, 1e-2, compiled=False).message


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
def test_with_a_broken_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "brokencc"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o700)
    monkeypatch.setenv("CC", str(broken))
    run = simulate(prism(), 100.0, 1e-3, verify=False)
    assert run.time[-1] == 100.0
    assert not run.compiled
    assert "brokencc failed" in run.message
    with pytest.raises(CompileError, match="brokencc"):
        simulate(prism(), 0.1, 1e-2, compiled=True)
