"""Exported C: compiles without a warning and without CasADi at hand, runs, and gives the simulator's numbers."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scenes import every_term

from tenscasadi.analysis.modes import linearize
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.scene.terrain import Terrain
from tenscasadi.scene.winches import RestLengthRate
from tenscasadi.simulation.export import export_c
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import Single

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
STRICT = ["-std=c99", "-O1", "-Wall", "-Werror"]


def run(folder: Path, *arguments: str) -> np.ndarray:
    """Rows that the exported program prints, after a strict compilation with nothing but the exported files."""
    assert COMPILER is not None
    build = [COMPILER, *STRICT, "tensegrity.c", "main.c", "-lm", "-o", "run"]
    subprocess.run(build, cwd=folder, check=True, capture_output=True, text=True)
    done = subprocess.run([folder / "run", *arguments], check=True, capture_output=True, text=True)
    return np.array(
        [[float(value) for value in line.split(",")] for line in done.stdout.splitlines()]
    )


def rolling() -> Scene:
    """A double pendulum whose pivot rolls down an incline, over a height field with friction and a wall for one node."""
    pendulum = shapes.double_pendulum()
    low = float(pendulum.nodes[:, 1].min())
    x = np.linspace(-3, 3, 7)
    field = Terrain(0.3 * np.sin(x[:, None]) * np.cos(x), (-3, -3), (3, 3), 2e3, 5.0, friction=0.4)
    return Scene(
        pendulum.replace(pinned={}, rollers={0: (0.3, 1, 0.1)}, node_mass=0.2),
        gravity=Gravity((0.0, -3.0, -5.0)),
        ground=[field, Ground(1e3, normal=(0, 1, 0), height=low + 0.1, nodes=[2])],
    )


SLOW = "terrain, wall and a roller", "class k, full coordinates"  # parts of "every term"
MODELS = {
    "winches": lambda: Model(
        Scene(shapes.prism(prestress=20.0, damping=0.5), control=RestLengthRate())
    ),
    "every term": lambda: Model(every_term(), "full"),
    "class 1 with ground": lambda: Model(
        Scene(
            shapes.prism(prestress=20.0, damping=0.5),
            gravity=Gravity(),
            ground=Ground(1e3, 1.0, friction=0.3),
        )
    ),
    "terrain, wall and a roller": lambda: Model(rolling(), "full"),
    "terrain, wall and a roller, reduced": lambda: Model(rolling()),
    "class k, full coordinates": lambda: Model(
        Scene(shapes.d_bar(prestress=20.0, pinned=(0,)), gravity=Gravity((1, 2, 3))), "full"
    ),
    "class k, reduced": lambda: Model(Scene(shapes.double_pendulum(), gravity=Gravity())),
    "force densities": lambda: Model(
        Scene(shapes.prism(prestress=20.0, height=0.8), control=ForceDensity())
    ),
    "parameters": lambda: Model(
        Scene(
            shapes.prism(prestress=20.0, damping=0.5),
            gravity=Gravity(),
            parameters=Parameters("bar_mass", "gravity", scale=["damping"]),
        )
    ),
    "class 0": lambda: Model(
        Scene(Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0, rest_length=0.5))
    ),
}


@needs_compiler
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in MODELS]
)
def test_the_exported_program_gives_the_simulators_numbers(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    files = export_c(model, tmp_path / "c")
    assert [path.name for path in files] == ["tensegrity.c", "tensegrity.h", "start.h", "main.c"]
    rows = run(tmp_path / "c", "0.1", "0.001", "10")
    ours = simulate(model, 0.1, 1e-3, correction=Projection(), save_every=10, compiled=False)
    assert np.allclose(rows[:, 0], ours.time)
    assert np.allclose(rows[:, 1:-2].reshape(ours.nodes.shape), ours.nodes, rtol=1e-12, atol=1e-12)
    assert np.allclose(rows[:, -2], ours.energy, rtol=1e-10, atol=1e-10)


@needs_compiler
def test_the_program_starts_with_the_parameters_that_are_given(tmp_path: Path) -> None:
    model, given = (
        MODELS["parameters"](),
        {"bar_mass": [1.0, 2.0, 3.0], "gravity": [0.0, 1.0, -2.0]},
    )
    export_c(model, tmp_path, parameters=given)
    ours = simulate(
        model, 0.05, 1e-3, correction=Projection(), save_every=50, parameters=given, compiled=False
    )
    assert np.allclose(
        run(tmp_path, "0.05", "0.001", "1")[-1, 1:-2],
        ours.nodes[-1].ravel(),
        rtol=1e-12,
        atol=1e-12,
    )


@needs_compiler
def test_the_program_takes_functions_that_casadi_cannot_trace(tmp_path: Path) -> None:
    push = NodalForce(lambda t: [(0, 0, 0), (math.sin(9 * t), 0, 0)])
    model = Model(Scene(shapes.pendulum(), forces=push))
    export_c(model, tmp_path, t_end=0.5)
    rows = run(tmp_path, "0.5", "1e-3", "1")
    nodes = simulate(model, 0.5, 1e-3, compiled=False).nodes[-1]
    assert rows[-1, 1:7] == pytest.approx(nodes.ravel(), abs=1e-9)
    late = subprocess.run([tmp_path / "run", "0.6"], capture_output=True, text=True, check=False)
    assert late.returncode == 2
    assert "known until 0.5 s" in late.stderr


def test_the_program_without_functions_of_time_has_no_last_time(tmp_path: Path) -> None:
    export_c(Model(Scene(shapes.pendulum())), tmp_path, t_end=0.5)
    assert "T_END" not in (tmp_path / "start.h").read_text()


def test_functions_of_time_are_checked_until_the_end(tmp_path: Path) -> None:
    for function, told in {
        lambda t: np.sqrt(0.5 - t): r"Gravity\.acceleration is not finite at t = 0\.5",
        lambda t: 1 / 0 if t > 0.5 else 0.0: r"Gravity\.acceleration\(0\.75\) fails with ZeroDiv",
    }.items():
        gravity = Gravity(lambda t, function=function: (0, 0, function(t)))
        with pytest.raises(ValueError, match=told):
            export_c(Model(Scene(shapes.pendulum(), gravity=gravity)), tmp_path, t_end=1.0)


@needs_compiler
def test_single_precision_is_single_precision(tmp_path: Path) -> None:
    model = MODELS["class 1 with ground"]()
    export_c(model, tmp_path, precision=Single())
    rows = run(tmp_path, "0.1", "0.001", "10")
    ours = simulate(model, 0.1, 1e-3, correction=Projection(), save_every=10, compiled=False)
    error = abs(rows[:, 1:-2].reshape(ours.nodes.shape) - ours.nodes).max()
    assert 1e-9 < error < 1e-4


@needs_compiler
def test_the_program_refuses_bad_arguments_and_stops_on_divergence(tmp_path: Path) -> None:
    export_c(MODELS["class 1 with ground"](), tmp_path)
    run(tmp_path, "0.01", "0.001", "1")
    bad = subprocess.run([tmp_path / "run", "-1"], capture_output=True, text=True)
    assert bad.returncode == 2
    assert len(run(tmp_path, "1e-7", "1", "1")) == 2  # one step, shorter than asked
    assert "usage" in bad.stderr
    wild = subprocess.run([tmp_path / "run", "1000", "1", "5"], capture_output=True, text=True)
    assert wild.returncode == 1
    assert "smaller step" in wild.stderr


@needs_compiler
@pytest.mark.parametrize("name", MODELS)
def test_exported_derivatives_are_those_of_the_linearisation(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    export_c(model, tmp_path)
    assert COMPILER is not None
    subprocess.run(
        [COMPILER, "-std=c99", "-O0", "-fPIC", "-shared", "tensegrity.c", "-lm", "-o", "lib.so"],
        cwd=tmp_path,
        check=True,
    )
    x = model.initial_state + 1e-3 * np.random.default_rng(0).normal(size=model.nx)
    given = [x, model.initial_control, *([model.parameters.nominal] if model.np else [])]
    A, B, *rest = (
        value.full() for value in ca.external("ode_jacobian", str(tmp_path / "lib.so"))(*given)
    )
    linear = linearize(model, x)
    assert all(np.allclose(P, linear.by_parameters, rtol=1e-9, atol=1e-9) for P in rest)
    assert np.allclose(A, linear.A, rtol=1e-9, atol=1e-9)
    assert np.allclose(B, linear.B, rtol=1e-9, atol=1e-9)


def test_bad_input_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="model"):
        export_c("prism", tmp_path)  # type: ignore[arg-type]
    model = MODELS["class 0"]()
    with pytest.raises(TypeError, match=r"precision is 'single': give Single\(\)"):
        export_c(model, tmp_path, precision="single")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"RungeKutta4\(\)"):
        export_c(model, tmp_path, RungeKutta4)  # type: ignore[arg-type]


@pytest.mark.parametrize("scheme", [Cvodes(), Idas(), DormandPrince853(rtol=1e-6)])
def test_schemes_that_choose_their_steps_are_no_c_code(scheme: Scheme, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="chooses its steps: give one of fixed steps"):
        export_c(MODELS["class 0"](), tmp_path, scheme)
    assert not list(tmp_path.iterdir())


@needs_compiler
@pytest.mark.parametrize(
    "scheme",
    [
        DormandPrince853(),
        Rattle(),
        pytest.param(Collocation(2, "radau"), marks=pytest.mark.slow),
    ],
)
def test_every_scheme_of_fixed_steps_is_exported(scheme: Scheme, tmp_path: Path) -> None:
    model = MODELS["class 1 with ground"]()
    export_c(model, tmp_path, scheme)
    ours = simulate(model, 0.05, 1e-3, scheme, correction=Projection(), compiled=False)
    assert np.allclose(
        run(tmp_path, "0.05", "0.001", "1")[-1, 1:-2],
        ours.nodes[-1].ravel(),
        rtol=1e-12,
        atol=1e-12,
    )
