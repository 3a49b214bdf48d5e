"""Scenes go to files and come back as the same model to the last bit; what files cannot hold is refused by name."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_strategies import scenes
from scenes import every_term
from structures import STRUCTURES

import tenscasadi as tc

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HEAD = 'format = 1\nunits = "SI"\n'


def model(scene: tc.Scene) -> tc.Model:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.RedundantConstraints)
        return tc.Model(scene)


def assert_same(scene: tc.Scene, other: tc.Scene, seed: int = 0) -> None:
    fields, others = scene.structure.to_fields(), other.structure.to_fields()
    for own in (fields, others):
        own |= own.pop("derived", {})
    for name, value in fields.items():
        same = np.asarray(value, dtype=object if isinstance(value, dict) else None)
        assert same.tobytes() == np.asarray(others[name]).tobytes() or value == others[name], name
    one, two = model(scene), model(other)
    assert one.ode.serialize() == two.ode.serialize()
    rng = np.random.default_rng(seed)
    inputs = [rng.normal(size=one.ode.size1_in(k)) for k in range(one.ode.n_in())]
    np.testing.assert_array_equal(one.ode(*inputs).full(), two.ode(*inputs).full())
    np.testing.assert_array_equal(one.initial_state, two.initial_state)
    np.testing.assert_array_equal(one.parameters.nominal, two.parameters.nominal)


def written(scene: tc.Scene | tc.Simulation, folder: Path, ending: str = "toml") -> Path:
    return tc.save_scene(scene, folder / f"scene.{ending}")


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(scenes(), st.integers(0, 99), st.sampled_from(["toml", "json"]))
def test_scenes_come_back_to_the_last_bit(tmp_path_factory, scene, seed, ending):
    path = written(scene, tmp_path_factory.getbasetemp(), ending)
    loaded = tc.load_scene(path)
    assert_same(scene, loaded, seed)
    text = path.read_text(encoding="utf-8")
    assert written(loaded, path.parent, ending).read_text(encoding="utf-8") == text


def test_toml_and_json_hold_the_same(tmp_path):
    (tmp_path / "mast.toml").write_text(FILE, encoding="utf-8")
    data = tomllib.loads(FILE)
    (tmp_path / "mast.json").write_text(json.dumps(data, indent=1), encoding="utf-8")
    one, other = (tc.load_simulation(tmp_path / f"mast.{ending}") for ending in ("toml", "json"))
    assert_same(one.scene, other.scene)
    data["structure"]["strings"]["front"]["stiffness"] = -1
    (tmp_path / "mast.json").write_text(json.dumps(data, indent=1), encoding="utf-8")
    with pytest.raises(tc.SceneFileError) as caught:
        tc.load_simulation(tmp_path / "mast.json")
    assert caught.value.key == "structure.strings.front.stiffness"
    line = (tmp_path / "mast.json").read_text(encoding="utf-8").splitlines()[caught.value.line - 1]
    assert '"stiffness": -1' in line


@pytest.mark.parametrize("ending", ["toml", "json"])
def test_subdivided_structures_come_back(tmp_path, ending):
    scene = tc.Scene(tc.shapes.prism(string_mass=0.1).subdivide(2))
    loaded = tc.load_scene(written(scene, tmp_path, ending))
    assert_same(scene, loaded)
    for name in ("string_parent", "string_fraction"):
        expected = getattr(scene.structure, name)
        np.testing.assert_array_equal(getattr(loaded.structure, name), expected)


def test_names_come_back(tmp_path):
    (tmp_path / "mast.toml").write_text(FILE, encoding="utf-8")
    named = tc.load_scene(tmp_path / "mast.toml")
    assert named.structure.node_names == ("foot", "top", "a", "b", "c")
    assert named.structure.string_names == ("front", "guys[0]", "guys[1]")
    assert named.structure.names.named["string"]["guys"] == [1, 2]
    again = tc.load_scene(tc.save_scene(named, tmp_path / "again.toml"))
    for which in ("node", "string", "bar"):
        name = f"{which}_names"
        assert getattr(again.structure, name) == getattr(named.structure, name)


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_come_back(name, tmp_path):
    scene = tc.Scene(STRUCTURES[name], gravity=tc.Gravity())
    assert_same(scene, tc.load_scene(written(scene, tmp_path)))


def test_every_term_comes_back(tmp_path):
    scene = every_term(moved=False)
    assert_same(scene, tc.load_scene(written(scene, tmp_path)))


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (
            lambda: tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity(lambda t: (0, 0, -t))),
            "Gravity.acceleration",
        ),
        (
            lambda: tc.Scene(
                tc.shapes.pendulum(), forces=tc.NodalForce(lambda t: [[0, 0, 0], [t, 0, 0]])
            ),
            "NodalForce.values",
        ),
        (
            lambda: tc.Scene(
                tc.shapes.pendulum(), supports=tc.SupportMotion({0: lambda t: (t**2, 0, 0)})
            ),
            "SupportMotion.positions",
        ),
        (
            lambda: tc.Simulation(
                tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()),
                1.0,
                control=lambda t: np.ones(9),
            ),
            "Simulation.control",
        ),
        (
            lambda: tc.Simulation(tc.Scene(tc.shapes.prism()), 1.0, scheme=_own_scheme()),
            "Simulation.scheme",
        ),
    ],
)
def test_unwritable_fields_are_rejected_by_name(scene, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        written(scene(), tmp_path)
    assert not list(tmp_path.iterdir())


def test_earlier_name_of_breakpoints_is_read(tmp_path):
    path = tmp_path / "old.toml"
    path.write_text(
        f"{HEAD}structure.shape = 'pendulum'\n"
        "scene.gravity = {acceleration = [0, 0, '-t'], breaks = [0.5]}"
    )
    assert tuple(tc.load_scene(path).gravity.breakpoints) == (0.5,)


def test_formulas_that_their_numbers_make_too_long_are_rejected(tmp_path):
    path = tmp_path / "deep.toml"
    path.write_text(
        f"{HEAD}numbers.a = -1.5\nstructure.shape = 'pendulum'\nscene.gravity = [0, 0, '{'+'.join('a' * 300)} + t']"
    )
    with pytest.raises(ValueError, match=r"Gravity.acceleration: with its numbers a formula of"):
        tc.save_scene(tc.load_scene(path), tmp_path / "again.toml")
    assert not (tmp_path / "again.toml").exists()


def _own_scheme() -> tc.RungeKutta4:
    class Own(tc.RungeKutta4):
        pass

    return Own()


@pytest.mark.parametrize(
    "options",
    [
        {
            "scheme": tc.DormandPrince853(rtol=1e-9, atol=1e-12),
            "save_every": 3,
            "energy_balance": False,
        },
        {"scheme": tc.Rattle(order=4), "correction": tc.Projection(every=2), "coordinates": "full"},
        {
            "scheme": tc.Collocation(3, "radau"),
            "correction": tc.BarLengthCorrection(0.5),
            "step": 0.01,
        },
        {"scheme": tc.Cvodes(1e-7), "control": np.full(9, 30.1)},
        {"scheme": tc.Idas(1e-7, 1e-8), "control": np.linspace(20.1, 40, 27).reshape(3, 9)},
    ],
)
def test_simulations_come_back(options, tmp_path):
    scene = tc.Scene(tc.shapes.prism(), control=tc.ForceDensity() if "control" in options else None)
    rng = np.random.default_rng(0)
    first = tc.Simulation(scene, 0.3, velocities=rng.normal(size=(6, 3)), project=True, **options)
    second = tc.load_simulation(written(first, tmp_path))
    for name in (
        "t_end",
        "step",
        "scheme",
        "correction",
        "save_every",
        "coordinates",
        "project",
        "energy_balance",
    ):
        assert getattr(first, name) == getattr(second, name), name
    np.testing.assert_array_equal(first.start, second.start)
    np.testing.assert_array_equal(first.control, second.control) if "control" in options else None
    again = tc.Simulation(scene, 0.3, state=first.start, **options)
    np.testing.assert_array_equal(tc.load_simulation(written(again, tmp_path)).start, first.start)


def test_a_run_from_a_file_is_that_of_simulate(tmp_path):
    scene = tc.Scene(
        tc.shapes.prism(prestress=20.0),
        gravity=tc.Gravity(),
        parameters=tc.Parameters("stiffness", groups={"stiffness": "all"}),
    )
    spun = np.cross([0, 0, 2.0], scene.structure.nodes)
    given = tc.Simulation(
        scene, 0.05, velocities=spun, parameters={"stiffness": 120.0}, correction=tc.Projection()
    )
    run = tc.load_simulation(written(given, tmp_path)).run(compiled=False)
    m = tc.Model(scene)
    expected = tc.simulate(
        m,
        0.05,
        state=m.state(scene.structure.nodes, spun),
        parameters={"stiffness": 120.0},
        correction=tc.Projection(),
        compiled=False,
    )
    np.testing.assert_array_equal(run.nodes, expected.nodes)


def test_projected_starts_keep_bars_for_the_masses_that_are_given():
    scene = tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("bar_mass"))
    velocities = np.random.default_rng(0).normal(size=(6, 3))
    light, heavy = (
        tc.Simulation(scene, 0.1, velocities=velocities, project=True, parameters={"bar_mass": m})
        for m in ([1, 1, 1], [1, 2, 30.0])
    )
    for simulation in (light, heavy):
        v = simulation.model.velocities(simulation.start)
        bars = scene.structure.bars
        stretch = np.sum(
            (v[bars[:, 1]] - v[bars[:, 0]])
            * (scene.structure.nodes[bars[:, 1]] - scene.structure.nodes[bars[:, 0]]),
            axis=1,
        )
        assert np.abs(stretch).max() < 1e-12


def test_nodes_inside_strings_start_on_the_line_between_the_ends(tmp_path):
    scene = tc.Scene(tc.shapes.d_bar(string_mass=0.1), segments=3)
    moved, velocities = (
        scene.structure.nodes + [0.1, 0.2, 0.3],
        np.cross([0, 0, 1.0], scene.structure.nodes),
    )
    first = tc.Simulation(scene, 1.0, nodes=moved, velocities=velocities)
    nodes, speeds = first.model.nodes(first.start), first.model.velocities(first.start)
    np.testing.assert_allclose(nodes, scene.modelled.nodes + [0.1, 0.2, 0.3], atol=1e-15)
    np.testing.assert_allclose(speeds, np.cross([0, 0, 1.0], scene.modelled.nodes), atol=1e-15)
    np.testing.assert_array_equal(tc.load_simulation(written(first, tmp_path)).start, first.start)


FILE = (
    HEAD
    + """
[numbers]
height = 2.0
wind = 15
[structure]
bar_mass = 3.0
pinned = ["foot", "a", "b", "c"]
[structure.nodes]
foot = [0, 0, 0]
top = [0, 0, "height"]
a = [1, 0, 0]
b = ["-cos(60 deg)", "sin(60 deg)", 0]
c = ["-cos(60 deg)", "-sin(60 deg)", 0]
[structure.bars]
mast = [["foot", "top"]]
[structure.strings.front]
members = [["top", "a"]]
stiffness = 500
force_density = 40
[structure.strings.guys]
members = [["top", "b"], ["top", "c"]]
stiffness = [400, "800 / 2"]
rest_length = 2.1
[scene]
slack = { guys = "Linear" }
parameters = { names = ["stiffness"], groups = { stiffness = [["front"], ["guys"]] } }
[scene.forces]
values = { top = ["wind * sin(2*t)", 5, 0] }
[start]
velocities = { top = [0.1, 0, 0] }
[simulation]
t_end = 0.5
"""
)


def test_names_groups_and_formulas_are_resolved(tmp_path):
    (tmp_path / "mast.toml").write_text(FILE, encoding="utf-8")
    found = tc.load_simulation(tmp_path / "mast.toml")
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3)
    mast = tc.Structure(
        [(0, 0, 0), (0, 0, 2), (1, 0, 0), (-c, s, 0), (-c, -s, 0)],
        [(0, 1)],
        [(1, 2), (1, 3), (1, 4)],
        3.0,
        pinned=[0, 2, 3, 4],
        stiffness=[500, 400, 400],
    )
    mast = mast.replace(rest_length=[mast.string_lengths[0] * (1 - 40 / 500), 2.1, 2.1])
    forces = tc.NodalForce(
        lambda t: [[0, 0, 0], [15 * np.sin(2 * t), 5, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    )
    parameters = tc.Parameters("stiffness", groups={"stiffness": [[0], [1, 2]]})
    scene = tc.Scene(
        mast, forces=forces, slack={1: tc.Linear(), 2: tc.Linear()}, parameters=parameters
    )
    assert found.scene.slack == scene.slack
    assert found.scene.parameters == parameters
    for name in ("nodes", "rest_length", "stiffness", "bar_mass", "fixed"):
        np.testing.assert_allclose(
            getattr(found.scene.structure, name), getattr(mast, name), rtol=1e-15, atol=1e-15
        )
    velocities = np.zeros((5, 3))
    velocities[1, 0] = 0.1
    m = tc.Model(scene)
    x = np.append(m.state(mast.nodes, velocities)[:-1], 0.7)
    p = m.parameters.nominal
    np.testing.assert_allclose(
        found.model.ode(x, [], p).full(), m.ode(x, [], p).full(), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(found.start[:-1], x[:-1], atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("stiffness = 500", "stiffness = -1", "structure.strings.front.stiffness", "at least 0"),
        ('[400, "800 / 2"]', "[400, -2]", "structure.strings.guys.stiffness", "of string 2 is -2"),
        ("stiffness = 500", "stifness = 500", "structure.strings.front.stifness", "did you mean 'stiffness'?"),
        ("force_density = 40", "force_density = 1000", "structure.strings.front.force_density", "below its stiffness"),
        ("force_density = 40", "force_density = 40\nrest_length = 1", "structure", "leave one of them out"),
        ('"Linear"', '"Liner"', "scene.slack.guys", "did you mean 'Linear'?"),
        ("{ guys", "{ guy", "scene.slack.guy", "did you mean 'guys'?"),
        ('"foot", "a"', '"fot", "a"', "structure.pinned[0]", "did you mean 'foot'?"),
        ('["top", "b"]', '["top"]', "structure.strings", "give the two nodes"),
        ('["top", "b"]', '["top", 17]', "structure.strings.guys.members[0][1]", "run from 0 to 4"),
        ('["top", "b"]', '["top", 1.5]', "structure.strings.guys.members[0][1]", "name or index"),
        ("foot = [0, 0, 0]", "foot = [0, 0]", "structure.nodes.foot", "a list of 3 numbers"),
        ("foot = [0, 0, 0]", "foot = [0, 0, true]", "structure.nodes.foot[2]", "is True"),
        ("foot = [0, 0, 0]", "foot = [0, 0, 1e200]", "structure.nodes.foot[2]", "finite"),
        ("bar_mass = 3.0", "bar_mass = [1, 2]", "structure.bar_mass", "shape (1,)"),
        ("bar_mass = 3.0", "shape = 'prism'", "structure.nodes", "give one of them"),
        ("bar_mass = 3.0", "bar_mas = 3.0", "structure.bar_mas", "did you mean 'bar_mass'?"),
        ("wind * sin", "wnd * sin", "scene.forces.values.top[0]", "did you mean 'wind'?"),
        ("[scene.forces]", "[scene.force]", "scene.force", "did you mean 'forces'?"),
        ("t_end = 0.5", "t_end = -1", "simulation.t_end", "greater than 0"),
        ("t_end = 0.5", "", "simulation", "has no t_end"),
        ("t_end = 0.5", "t_end = 1\nscheme = {kind = 'Ratle'}", "simulation.scheme.kind", "did you mean 'Rattle'?"),
        ("t_end = 0.5", "t_end = 1\nscheme = {rtol = 1}", "simulation.scheme", "has no kind"),
        ("t_end = 0.5", "t_end = 1\ncontrol = [1]", "simulation.control", "give an array of shape (0,)"),
        ("t_end = 0.5", "t_end = 1\ncontrol = ['1 + t']", "simulation.control", "give an array of shape (0,)"),
        ("t_end = 0.5", "t_end = 1\nparameters = {stiffness = [1]}", "simulation.parameters", "stiffness"),
        ("t_end = 0.5", "t_end = 1\nstep = 1e-30", "simulation.step", "larger step"),
        ("t_end = 0.5", "t_end = 1e6\nsave_every = 1", "simulation.save_every", "give more"),
        ("velocities = { top = [0.1, 0, 0] }", "spin = [0, 0, 1]", "start.spin", "moves a pinned coordinate"),
        ("t_end = 0.5", "t_end = '10 s'", "simulation.t_end", "units are SI"),
        ("velocities = { top", "velocities = { foot", "start.velocities", "moves a pinned coordinate"),
        ("[start]", "[start]\nkind = 'Clip'", "start.kind", "is no field of start"),
        ("[start]", "[start]\nstate = [1, 2]", "start.velocities", "beside state"),
        ("[scene]", "[scene]\nsegments = 100000000", "scene.segments", "at most"),
        ("[scene]", "[scene]\nsegments = 0", "scene.segments", "at least 1"),
        ("[scene]", "[scene]\ngravity = 9.81", "scene.gravity", "a list of 3 numbers"),
    ],
)  # fmt: skip
def test_faults_tell_key_and_cure(old, new, key, words, tmp_path):
    path = tmp_path / "mast.toml"
    assert old in FILE
    path.write_text(FILE.replace(old, new), encoding="utf-8")
    with pytest.raises(tc.SceneFileError) as caught:
        tc.load_simulation(path)
    error = caught.value
    assert (error.file, error.key) == ("mast.toml", key)
    assert words in str(error)
    assert "\n" not in str(error)
    wanted = key.split(".")[-1].split("[")[0]
    assert error.line is not None
    assert wanted in path.read_text(encoding="utf-8").splitlines()[error.line - 1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no [structure]"),
        ("[structure]\n", "neither nodes nor shape"),
        ("[structure]\nshape = 'prisn'", "did you mean 'prism'?"),
        ("[structure]\nshape = 'prism'\nbars = 2", "at least 3"),
        ("[structure]\nshape = 'prism'\nbars = 1e9", "at most"),
        ("[structure]\nshape = 'membrane'\np = 90000\nq = 90000", "at most"),
        ("[structure]\nshape = 'prism'\nradus = 2", "did you mean 'radius'?"),
        ("[structure]\nshape = 'prism'\npinned = [9]", "run from 0 to 5"),
        (
            f"[structure]\nshape = 'prism'\npinned = [0x{'f' * 6000}]",
            "run from 0 to 5",
        ),  # too long for Python to show
        ("[structure]\nshape = 'prism'\nprestress = 5\nforce_density = 3", "leave one of them out"),
        ("[structure]\nshape = 'prism'\nturn = {axis = [0, 0, 0], angle = 1}", "give a direction"),
        ("[structure]\nnodes = []", "at least one node"),
        ("[structure]\nnodes = [[0, 0, 0], [1, 0]]", "has 2 entries"),
        ("structure = 3", "give a table"),
        (
            "[structure]\nnodes = {1 = [0, 0, 0], 2 = [0, 0, 1], 3 = [0, 1, 0]}\nbars = [[1, 2]]",
            "structure.nodes.1: is the name of node 0, and an index",
        ),
        (
            "[structure]\nnodes = [[0, 0, 0], [0, 0, 1]]\nbars = {1 = [[0, 1]]}",
            "structure.bars.1: is the name of a group of bars, and an index",
        ),
    ],
)
def test_faults_of_structures(text, words, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    with pytest.raises(tc.SceneFileError) as caught:
        tc.load_scene(path)
    assert words in str(caught.value)


def test_shapes_take_all_that_structures_have(tmp_path):
    path = tmp_path / "scene.toml"
    text = "[structure]\nshape = 'prism'\nbars = 4\nstiffness = 500\nprestress = 20\nnode_mass = {0 = 2}\npinned = [0]\n"
    path.write_text(
        HEAD + text + "turn = {axis = [0, 0, 2], angle = '90 deg'}\nmove = [1, 2, 3]",
        encoding="utf-8",
    )
    found = tc.load_scene(path).structure
    prism = tc.shapes.prism(
        4, stiffness=500, prestress=20, node_mass=[2, 0, 0, 0, 0, 0, 0, 0], pinned=[0]
    )
    x, y, z = prism.nodes.T
    np.testing.assert_allclose(found.nodes, np.column_stack([-y, x, z]) + [1, 2, 3], atol=1e-15)
    for name in ("rest_length", "node_mass", "fixed", "bars", "strings"):
        np.testing.assert_array_equal(getattr(found, name), getattr(prism, name))
