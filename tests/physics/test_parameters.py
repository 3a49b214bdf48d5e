"""Runs of a model with parameters equal those of models that are built with the values."""

import numpy as np
import pytest

import tenscasadi as tc
import tenscasadi.util.compile as compiling
from tenscasadi.ensemble.kernel import build_kernel

STRINGS = "stiffness", "damping", "rest_length"
GROUND = "ground_stiffness", "ground_damping", "ground_friction"
ALL = (*STRINGS, "bar_mass", "node_mass", "gravity", *GROUND)
ATTRIBUTES = {"stiffness": "stiffness", "damping": "damping", "friction": "friction"}


def ground(stiffness=1e4, damping=10.0, friction=0.5):
    return tc.Ground(stiffness=stiffness, damping=damping, friction=friction, height=-0.05)


def pair(structure, names, coordinates="reduced", seed=0, **options):
    """A model with parameters, values of them, and the model that is built with these."""
    options = {"gravity": tc.Gravity(), "ground": ground(), **options}
    given = tc.Model(tc.Scene(structure, parameters=tc.Parameters(*names), **options), coordinates)
    random = np.random.default_rng(seed)
    p = given.parameters.nominal * random.uniform(0.8, 1.2, given.np) + 0.02 * random.uniform(size=given.np)
    item = {name: given.parameters.quantities[name].numbers(p) for name in names}
    changed = structure.replace(**{name: values for name, values in item.items() if name in tc.structure.structure.PARAMETERS})
    if "gravity" in item:
        options["gravity"] = tc.Gravity(item["gravity"])
    if options["ground"] is not None:
        options["ground"] = ground(**{name.removeprefix("ground_"): values[0] for name, values in item.items() if name.startswith("ground_")})
    if "pressure" in item:
        options["pressure"] = tc.Pressure(options["pressure"].faces, item["pressure"][0])
    if "forces" in item:
        options["forces"] = tc.NodalForce(item["forces"].reshape(-1, 3))
    return given, p, tc.Model(tc.Scene(changed, **options), coordinates)


def prism():
    return tc.shapes.prism(stiffness=1000.0, prestress=50.0, damping=2.0, string_mass=0.1)


def assert_same(one, other, rtol):
    for name in ("nodes", "velocities", "tension", "energy", "energy_error"):
        a, b = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * max(1.0, abs(b).max(initial=0)))
    assert one.success
    assert other.success


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize(
    ("scheme", "correction", "rtol"),
    [
        (tc.RungeKutta4(), tc.Projection(), 1e-12),
        (tc.Rattle(), None, 1e-10),
        (tc.DormandPrince54(rtol=1e-6), tc.Projection(), 1e-10),
        (tc.Collocation(2), None, 1e-9),
        (tc.Cvodes(rtol=1e-10), tc.Projection(), 1e-5),
        (tc.Idas(rtol=1e-10), None, 1e-5),
    ],
    ids=lambda value: type(value).__name__,
)
def test_runs_are_those_of_a_model_built_with_the_values(scheme, correction, rtol, coordinates):
    given, p, built = pair(prism(), ALL, coordinates)
    options = {"t_end": 0.1, "step": 1e-3, "scheme": scheme, "correction": correction, "compiled": False}
    assert_same(tc.simulate(given, parameters=p, **options), tc.simulate(built, **options), rtol)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("control", [tc.RestLength(), tc.ForceDensity()])
def test_the_initial_control_follows_the_parameters(control, coordinates):
    given, p, built = pair(prism(), (*STRINGS, "bar_mass"), coordinates, control=control)
    assert np.allclose(given.control_at(p), built.initial_control, rtol=1e-14, atol=0)
    assert_same(*(tc.simulate(m, 0.05, parameters=q, compiled=False) for m, q in ((given, p), (built, None))), 1e-12)


def test_nominal_values_are_the_scene_itself():
    given, _, _ = pair(prism(), ALL)
    own = tc.Model(tc.Scene(prism(), gravity=tc.Gravity(), ground=ground()))
    assert_same(*(tc.simulate(m, 0.05, compiled=False) for m in (given, own)), 1e-12)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize(
    "structure", [tc.shapes.d_bar(), tc.shapes.double_pendulum(), tc.shapes.six_bar_ball(stiffness=500.0)], ids=["d_bar", "pendulum", "ball"]
)
def test_masses_of_joined_bars(structure, coordinates):
    names = ("bar_mass", "node_mass", "gravity")
    given, p, built = pair(structure, names, coordinates, ground=None)
    options = {"t_end": 0.2, "step": 2e-3, "correction": tc.Projection(), "compiled": False}
    assert_same(tc.simulate(given, parameters=p, **options), tc.simulate(built, **options), 1e-11)
    x = built.initial_state
    for one, other in zip(given.multipliers(x, parameters=p), built.multipliers(x), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_one_compiled_code_serves_all_values(monkeypatch):
    if compiling.find_compiler() is None:
        pytest.skip("no C compiler")
    model = tc.Model(tc.Scene(prism(), parameters=tc.Parameters(*STRINGS, "bar_mass"), gravity=tc.Gravity()))
    tc.simulate(model, 0.01, compiled=True)
    monkeypatch.setattr(compiling, "_build", lambda *_: pytest.fail("compiled again"))
    built = len(model.functions)
    runs = [tc.simulate(model, 0.01, compiled=True, parameters={"stiffness": k, "bar_mass": m}) for k, m in ((900, 1), (1000, 2), (1100, 0.5))]
    assert len(model.functions) == built
    assert len({run.energy[0] for run in runs}) == 3


def test_many_motions_side_by_side_are_those_of_simulate():
    model = tc.Model(tc.Scene(prism(), parameters=tc.Parameters("stiffness", "bar_mass", "node_mass"), gravity=tc.Gravity()))
    values = model.parameters.nominal * np.random.default_rng(0).uniform(0.9, 1.1, (3, model.np)) + 0.01
    kernel = build_kernel(model, tc.RungeKutta4(), tc.Projection())
    found = kernel(model.initial_state[None], values[:, None, :], 1e-3, 50)
    for row, p in zip(found.states, values, strict=True):
        run = tc.simulate(model, 0.05, 1e-3, correction=tc.Projection(), parameters=p, compiled=False)
        np.testing.assert_allclose(row, run.states[-1], rtol=0, atol=1e-12)
