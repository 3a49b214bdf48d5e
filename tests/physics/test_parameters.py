"""Runs of a model with parameters equal those of models that are built with the values."""

import copy
import pickle

import numpy as np
import pytest

import tenscasadi as tc
import tenscasadi.util.compile as compiling
from tenscasadi.simulation.engine.build import build_kernel

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
    p = given.parameters.nominal * random.uniform(0.8, 1.2, given.np) + 0.02 * random.uniform(
        size=given.np
    )
    item = {name: given.parameters.quantities[name].numbers(p) for name in names}
    changed = structure.replace(
        **{
            name: values
            for name, values in item.items()
            if name in tc.structure.structure.PARAMETERS
        }
    )
    if "gravity" in item:
        options["gravity"] = tc.Gravity(item["gravity"])
    if options["ground"] is not None:
        options["ground"] = ground(
            **{
                name.removeprefix("ground_"): values[0]
                for name, values in item.items()
                if name.startswith("ground_")
            }
        )
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


@pytest.mark.parametrize(
    ("scheme", "correction", "rtol", "coordinates"),
    [
        (tc.RungeKutta4(), tc.Projection(), 1e-12, "reduced"),
        (tc.RungeKutta4(), tc.Projection(), 1e-12, "full"),
        (tc.Rattle(), None, 1e-10, "full"),
        (tc.DormandPrince54(rtol=1e-6), tc.Projection(), 1e-10, "reduced"),
        (tc.Collocation(2), None, 1e-9, "reduced"),
        (tc.Cvodes(rtol=1e-10), tc.Projection(), 1e-5, "reduced"),
        (tc.Idas(rtol=1e-10), None, 1e-5, "full"),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, str) else value,
)
def test_runs_are_those_of_a_model_built_with_the_values(scheme, correction, rtol, coordinates):
    given, p, built = pair(prism(), ALL, coordinates)
    options = {
        "t_end": 0.04,
        "step": 1e-3,
        "scheme": scheme,
        "correction": correction,
        "compiled": False,
    }
    assert_same(tc.simulate(given, parameters=p, **options), tc.simulate(built, **options), rtol)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize(
    ("control", "names"),
    [(tc.RestLength(), STRINGS), (tc.ForceDensity(), ("stiffness", "rest_length"))],
)
def test_the_initial_control_follows_the_parameters(control, names, coordinates):
    with pytest.warns(UserWarning, match="only sets the default control"):
        given, p, built = pair(prism(), (*names, "bar_mass"), coordinates, control=control)
    assert np.allclose(given.control_at(p), built.initial_control, rtol=1e-14, atol=0)
    assert_same(
        *(
            tc.simulate(m, 0.05, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        ),
        1e-12,
    )


def test_nominal_values_are_the_scene_itself():
    given, _, _ = pair(prism(), ALL)
    own = tc.Model(tc.Scene(prism(), gravity=tc.Gravity(), ground=ground()))
    assert_same(*(tc.simulate(m, 0.05, compiled=False) for m in (given, own)), 1e-12)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize(
    "structure",
    [tc.shapes.d_bar(), tc.shapes.double_pendulum(), tc.shapes.six_bar_ball(stiffness=500.0)],
    ids=["d_bar", "pendulum", "ball"],
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
    model = tc.Model(
        tc.Scene(prism(), parameters=tc.Parameters(*STRINGS, "bar_mass"), gravity=tc.Gravity())
    )
    tc.simulate(model, 0.01, compiled=True)
    monkeypatch.setattr(compiling, "run_compiler", lambda *_: pytest.fail("compiled again"))
    built = len(model.functions)
    runs = [
        tc.simulate(model, 0.01, compiled=True, parameters={"stiffness": k, "bar_mass": m})
        for k, m in ((900, 1), (1000, 2), (1100, 0.5))
    ]
    assert len(model.functions) == built
    assert len({run.energy[0] for run in runs}) == 3


def test_many_motions_side_by_side_are_those_of_simulate():
    model = tc.Model(
        tc.Scene(
            prism(),
            parameters=tc.Parameters("stiffness", "bar_mass", "node_mass"),
            gravity=tc.Gravity(),
        )
    )
    values = (
        model.parameters.nominal * np.random.default_rng(0).uniform(0.9, 1.1, (3, model.np)) + 0.01
    )
    kernel = build_kernel(model, tc.RungeKutta4(), tc.Projection())
    found = kernel(model.initial_state[None], values[:, None, :], 1e-3, 50)
    for row, p in zip(found.states, values, strict=True):
        run = tc.simulate(
            model, 0.05, 1e-3, correction=tc.Projection(), parameters=p, compiled=False
        )
        np.testing.assert_allclose(row, run.states[-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_derivatives_by_parameters_are_those_of_differences(coordinates):
    given, p, _ = pair(
        tc.shapes.d_bar(stiffness=100.0, damping=1.0),
        (*STRINGS, "bar_mass", "node_mass", "gravity"),
        coordinates,
        ground=None,
    )
    x = given.initial_state + 0.05 * np.random.default_rng(1).normal(size=given.nx)
    exact = tc.linearize(given, x, parameters=p).by_parameters
    step = 1e-5
    ends = [
        [given.ode(x, [], p + sign * step * e).full().ravel() for e in np.eye(given.np)]
        for sign in (1, -1)
    ]
    np.testing.assert_allclose(
        exact, (np.array(ends[0]) - ends[1]).T / (2 * step), rtol=1e-6, atol=1e-6 * abs(exact).max()
    )
    assert (abs(exact).max(axis=0) > 0).any()


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_modes_and_largest_step_follow_the_parameters(coordinates):
    given, p, built = pair(prism(), (*STRINGS, "bar_mass", "node_mass"), coordinates, ground=None)
    one, other = tc.modes(given, parameters=p), tc.modes(built)
    np.testing.assert_allclose(one.frequency, other.frequency, rtol=1e-8)
    assert tc.stable_step(given, parameters=p) == pytest.approx(tc.stable_step(built), rel=1e-9)
    assert tc.stable_step(given) != pytest.approx(tc.stable_step(built), rel=1e-3)


def test_modes_of_large_structures_follow_the_parameters():
    structure = tc.shapes.membrane(p=16, q=14, stiffness=100.0)
    p = {"node_mass": 2.0 * structure.node_mass + 0.01}
    given = tc.Model(tc.Scene(structure, parameters=tc.Parameters("node_mass")))
    assert given.nq > 600
    built = given.with_parameters(p)
    np.testing.assert_allclose(
        tc.modes(given, count=4, parameters=p).frequency,
        tc.modes(built, count=4).frequency,
        rtol=1e-7,
    )


def test_studies_follow_the_parameters():
    given, p, built = pair(tc.shapes.double_pendulum(), ("bar_mass", "gravity"), ground=None)
    options = {"t_end": 0.2, "target_difference": 1e-8, "compiled": False}
    reference = tc.reference_solution(given, parameters=p, **options)
    assert np.allclose(reference.nodes, tc.reference_solution(built, **options).nodes, atol=1e-7)
    row, *_ = tc.tradeoff(
        given, 0.2, [tc.RungeKutta4()], [0.01], reference, compiled=[False], repeats=1, parameters=p
    ).rows
    assert row.position < 1e-4
    advice = tc.recommend(
        given, 0.2, 1e-4, schemes=[tc.RungeKutta4()], compiled=False, parameters=p
    )
    run = tc.simulate(given, 0.2, parameters=p, compiled=False, **advice.options)
    assert np.linalg.norm(run.nodes[-1] - reference.nodes, axis=1).max() < 1e-4


def test_a_trajectory_keeps_its_parameters(tmp_path):
    model = tc.Model(tc.Scene(prism(), parameters=tc.Parameters("bar_mass")))
    run = tc.simulate(model, 0.01, parameters=[1.0, 2.0, 3.0], compiled=False)
    again = tc.Trajectory.load(run.save(tmp_path / "run.npz"))
    assert again.parameters.tolist() == [1.0, 2.0, 3.0]
    assert not again.parameters.flags.writeable


def test_parameters_cost_their_own_instructions_alone():
    def count(**options):
        return tc.Model(tc.Scene(prism(), gravity=tc.Gravity(), **options)).ode.n_instructions()

    own = count()
    assert (
        count(parameters=tc.Parameters("stiffness", "damping")) <= own + 18 + 2
    )  # a number to read for each
    assert count(parameters=tc.Parameters(scale=["stiffness"])) <= own + 2 + 9
    assert count(parameters=tc.Parameters("bar_mass")) <= own + 3 * 15


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("bars", [8, 24])
def test_long_chains(bars, coordinates):
    nodes = [(k, 0.0, 0.1 * (k % 2)) for k in range(bars + 1)]
    chain = tc.Structure(
        nodes,
        [(k, k + 1) for k in range(bars)],
        [(0, bars)],
        pinned=[0],
        node_mass=0.1,
        stiffness=10.0,
    )
    given, p, built = pair(chain, ("stiffness", "bar_mass", "node_mass"), coordinates, ground=None)
    x = built.initial_state + 0.01 * np.random.default_rng(0).normal(size=built.nx)
    expected = built.ode(x, []).full()
    np.testing.assert_allclose(
        given.ode(x, [], p).full(), expected, rtol=0, atol=1e-11 * abs(expected).max()
    )
    np.testing.assert_allclose(
        tc.build_projection(given)(x, p).full(), tc.build_projection(built)(x).full(), atol=1e-12
    )


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_moved_supports_pull_at_the_masses_of_the_parameters(coordinates):
    shaken = tc.SupportMotion({0: lambda t: (0.1 * t, 0, 0)})
    given, p, built = pair(
        tc.shapes.double_pendulum(), ("bar_mass",), coordinates, ground=None, supports=shaken
    )
    assert_same(
        *(
            tc.simulate(m, 0.1, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        ),
        1e-10,
    )


@pytest.mark.parametrize("ends", ["interior", "lumped"])
def test_strings_in_segments_share_their_parameters(ends):
    structure = tc.shapes.prism(stiffness=500.0, prestress=20.0, damping=0.5, string_mass=0.1)
    given, p, built = pair(structure, (*STRINGS, "string_mass"), segments=3, ends=ends, ground=None)
    assert_same(
        *(
            tc.simulate(m, 0.02, 5e-4, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        ),
        1e-11,
    )


def test_pressure_and_forces():
    faces = tc.shapes.membrane_faces(p=8, q=5)
    membrane = tc.shapes.membrane(p=8, q=5, stiffness=50.0)
    loads = {
        "pressure": tc.Pressure(faces, 5.0),
        "forces": tc.NodalForce(np.full((len(membrane.nodes), 3), 0.1)),
        "gravity": None,
        "ground": None,
    }
    given, p, built = pair(membrane, ("pressure", "forces", "stiffness"), **loads)
    assert_same(
        *(
            tc.simulate(m, 0.05, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        ),
        1e-11,
    )


def test_masses_that_rounding_cannot_hold_together_are_refused():
    model = tc.Model(tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("bar_mass")))
    with pytest.raises(ValueError, match="bar 1 is 1e\\+20 times as heavy as bar 0"):
        tc.simulate(model, 0.1, parameters=[1.0, 1e20, 1.0], compiled=False)


@pytest.mark.parametrize("scaled", [False, True])
def test_forces_on_a_chosen_bar_of_a_joint(scaled):
    elbow = tc.shapes.double_pendulum()
    forces = tc.NodalForce(np.full((3, 3), 0.5), bars={1: 1})
    named = tc.Parameters(scale=["forces"]) if scaled else tc.Parameters("forces")
    given = tc.Model(tc.Scene(elbow, forces=forces, parameters=named), "full")
    built = tc.Model(
        tc.Scene(elbow, forces=tc.NodalForce(np.full((3, 3), 1.0), bars={1: 1})), "full"
    )
    x = built.initial_state
    one, other = (
        given.multipliers(x, parameters={"forces": 2.0 if scaled else 1.0}),
        built.multipliers(x),
    )
    np.testing.assert_allclose(one.joint_force, other.joint_force, atol=1e-12)


def test_masses_on_rollers_in_full_coordinates():
    mast = tc.Structure(
        [(0, 0, 0), (0.3, 0, 2)], [(0, 1)], pinned={0: "z"}, rollers={1: (1, 0, 1)}, node_mass=0.2
    )
    given, p, built = pair(mast, ("bar_mass", "node_mass", "gravity"), "full", ground=None)
    assert_same(
        *(
            tc.simulate(m, 0.1, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        ),
        1e-11,
    )


SCALED = tc.Parameters(
    scale=[
        "stiffness",
        "damping",
        "rest_length",
        "bar_mass",
        "gravity",
        "forces",
        "ground_stiffness",
        "ground_friction",
    ]
)
GROUPED = tc.Parameters(
    "bar_mass",
    "damping",
    scale=["stiffness"],
    groups={"bar_mass": [[0, 2]], "damping": "all", "stiffness": [[0, 1], [5]]},
)


@pytest.mark.parametrize("parameters", [SCALED, GROUPED], ids=["scaled", "grouped"])
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_scales_and_groups(parameters, coordinates):
    loads = {
        "gravity": tc.Gravity(lambda t: (0, 0, -9.81 * (1 + t))),
        "forces": tc.NodalForce(lambda t: [[t, 0, 0]] * 6),
        "ground": ground(),
    }
    given = tc.Model(tc.Scene(prism(), parameters=parameters, **loads), coordinates)
    p = given.parameters.nominal * np.random.default_rng(0).uniform(0.8, 1.2, given.np)
    built = given.with_parameters(p)
    assert built.np == 0
    assert_same(
        *(
            tc.simulate(m, 0.05, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        ),
        1e-11,
    )


@pytest.mark.parametrize(
    "slack",
    [
        tc.Smooth(1e-3),
        tc.Linear(),
        [tc.Clip()] * 3 + [tc.Smooth(1e-3)] * 3 + [tc.Clip(damping="unclamped")] * 3,
    ],
)
def test_every_law_of_a_string_takes_parameters(slack):
    given, p, built = pair(prism(), (*STRINGS, "bar_mass"), slack=slack)
    for scheme in (tc.RungeKutta4(), tc.Collocation(2), tc.DormandPrince54(rtol=1e-6)):
        runs = (
            tc.simulate(m, 0.05, 1e-3, scheme, parameters=q, compiled=False)
            for m, q in ((given, p), (built, None))
        )
        assert_same(*runs, 1e-9)


def test_models_with_parameters_survive_copies():
    model = tc.Model(tc.Scene(prism(), parameters=GROUPED))
    for again in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):  # noqa: S301
        assert again.parameters.names == model.parameters.names
        assert not again.parameters.nominal.flags.writeable
        x, p = model.initial_state, 1.1 * model.parameters.nominal
        assert np.array_equal(again.ode(x, [], p).full(), model.ode(x, [], p).full())
    layout = pickle.loads(pickle.dumps(model.parameters))  # noqa: S301
    assert not layout.nominal.flags.writeable
    assert np.array_equal(layout.values(p), p)
