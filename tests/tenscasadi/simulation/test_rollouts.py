"""Rollouts against `simulate`, motion by motion, and what they say where something is wrong."""

from __future__ import annotations

import copy
import signal
import threading
from importlib import import_module

import numpy as np
import pytest
from tqdm import tqdm

import tenscasadi as tc
from tenscasadi.simulation.engine import native as kernel_module
from tenscasadi.util.compile import CompileError

module = import_module(
    "tenscasadi.simulation.rollouts"
)  # the name in the package is the function's
STEP, T_END = 5e-4, 0.015


@pytest.fixture(scope="module")
def prism():
    structure = tc.shapes.prism(stiffness=800.0, damping=2.0, prestress=5.0)
    return tc.Model(
        tc.Scene(
            structure, gravity=tc.Gravity(), ground=tc.Ground(friction=0.5), control=tc.RestLength()
        )
    )


@pytest.fixture(scope="module")
def spring():
    """A mass on a string of 1 N/m² (1 kg, pulled along x): x'' = -u x."""
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned={0: "xyz", 1: "yz"}
    )
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity()))


def starts(model, n, speed=0.3):
    rng = np.random.default_rng(0)
    nodes = model.structure.nodes
    project = tc.build_projection(model)
    given = [
        model.state(
            nodes, np.where(model.structure.fixed, 0.0, speed) * rng.normal(0, 1, nodes.shape)
        )
        for _ in range(n)
    ]
    return np.array([np.asarray(project(x).full()).ravel() for x in given])


def controls(model, *shape):
    return model.initial_control * (1 + 0.05 * np.random.default_rng(1).random((*shape, model.nu)))


def test_tables_and_energies_are_those_of_simulate(prism):
    x, u = starts(prism, 5), controls(prism, 5, 3)
    many = tc.rollouts(
        prism, T_END, STEP, x, u, correction=tc.Projection(2), save_every=4, threads=2
    )
    assert many.success.all()
    for k in range(5):
        run = tc.simulate(
            prism,
            T_END,
            STEP,
            state=x[k],
            control=u[k],
            correction=tc.Projection(2),
            save_every=4,
            compiled=False,
        )
        np.testing.assert_array_equal(many.time, run.time)
        np.testing.assert_array_equal(many.states[k], run.states)
        np.testing.assert_array_equal(many.path(2)[k], run.nodes[:, 2])
        assert many.message[k] == run.message
        finest = tc.simulate(
            prism,
            T_END,
            STEP,
            state=x[k],
            control=u[k],
            correction=tc.Projection(2),
            save_every=1,
            compiled=False,
        )
        np.testing.assert_allclose(
            many.energy_error[k], abs(finest.energy_error).max(), rtol=1e-6, atol=1e-12
        )
        np.testing.assert_allclose(
            many.bar_length_error[k], finest.bar_length_error.max(), atol=1e-15
        )


def test_rows_where_the_control_changes_are_judged_as_by_simulate(prism):
    u = prism.initial_control * np.array([1.0, 0.7, 1.3, 0.9])[None, :, None]
    many = tc.rollouts(prism, 0.02, STEP, starts(prism, 3), u, save_every=5, verify=True)
    for k, x in enumerate(starts(prism, 3)):
        run = tc.simulate(prism, 0.02, STEP, state=x, control=u[0], save_every=5, compiled=False)
        assert many.success[k] == run.success
        assert many.error_estimate[k] == run.error_estimate
        assert ("(position error about" in many.message[k]) == ("(position error" in run.message)


def test_paths_of_moved_supports_outlive_a_start_that_is_lost():
    motion = tc.SupportMotion({0: lambda t: (0.1 * t, 0.0, 0.0)})
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity(), supports=motion))
    many = tc.rollouts(model, 0.1, 0.01, [np.full(model.nx, np.nan), model.initial_state])
    np.testing.assert_allclose(many.path(0)[1, :, 0], [0.0, 0.01], atol=1e-15)


def test_steps_end_where_tables_of_forces_have_times():
    push = np.zeros((3, 6, 3))
    push[1, 0, 2] = 30.0
    scene = tc.Scene(
        tc.shapes.prism(prestress=5.0),
        forces=tc.NodalForce(push, times=[0.0113, 0.0117, 0.0121]),
        control=tc.ForceDensity(),
    )
    model = tc.Model(scene)
    u = np.ones((1, 4, 1)) * model.initial_control
    many = tc.rollouts(model, 0.04, 0.004, controls=u, save_every=3)
    run = tc.simulate(model, 0.04, 0.004, control=u[0], save_every=3, compiled=False)
    np.testing.assert_array_equal(many.time, run.time)
    np.testing.assert_array_equal(many.states[0], run.states)
    assert np.isin(0.0117, tc.rollouts(model, 0.04, 0.004, save_every=1).time)


def test_moved_supports_have_paths():
    motion = tc.SupportMotion({0: lambda t: (0.1 * t, 0.0, 0.0)})
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity(), supports=motion))
    many = tc.rollouts(model, 0.1, 0.01, [model.initial_state] * 2, save_every=5)
    np.testing.assert_allclose(many.path(0)[:, :, 0], [[0.0, 0.005, 0.01]] * 2, atol=1e-15)
    np.testing.assert_allclose(many.path(1)[0], model.nodes(many.states)[0, :, 1], atol=1e-15)


def test_feedback_is_decided_at_its_times_and_goes_on_after_the_plan(spring):
    time = np.array([0.0, 0.1, 0.3, 0.4])
    rng = np.random.default_rng(2)
    feedback = tc.Feedback(
        time, rng.random((3, 1)), rng.random((4, 2)), rng.normal(0, 3, (3, 1, 2)), 0.2, 3.0
    )
    x = np.array([[1.0, 0.0], [0.7, 0.5], [0.2, -0.3]])
    many = tc.rollouts(spring, 0.65, 0.01, x, feedback)
    for k in range(3):
        state = x[k]
        for begin, end in zip(
            (0.0, 0.1, 0.3, 0.4, 0.5, 0.6), (0.1, 0.3, 0.4, 0.5, 0.6, 0.65), strict=True
        ):
            i = int(np.searchsorted(time, begin + 1e-9) - 1)
            gain = min(i, 2)
            u = np.clip(
                feedback.controls[gain] - feedback.gains[gain] @ (state - feedback.states[i]),
                0.2,
                3.0,
            )
            state = tc.simulate(
                spring, end - begin, 0.01, state=state, control=u, compiled=False
            ).states[-1]
        np.testing.assert_allclose(many.final[k], state, rtol=1e-13)


def test_feedback_whose_rest_lengths_may_vanish_is_refused():
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned={0: "xyz", 1: "yz"}
    )
    model = tc.Model(tc.Scene(structure, control=tc.RestLength()))
    still = {"time": [0.0, 0.1], "states": np.ones((2, 2))}
    for control, gain, lower in ((0.5, 3.0, -np.inf), (0.5, 3.0, 0.0), (-0.5, 0.0, -np.inf)):
        with pytest.raises(
            ValueError,
            match=r"limits of string 0 are .* and inf: rest lengths .* give Feedback\(lower=...\) above it",
        ):
            tc.rollouts(
                model,
                0.1,
                0.01,
                controls=tc.Feedback(
                    controls=[[control]], gains=[[[gain, 0.0]]], lower=lower, **still
                ),
            )
    for gain, lower in ((0.0, -np.inf), (3.0, 0.1)):
        assert tc.rollouts(
            model,
            0.1,
            0.01,
            controls=tc.Feedback(controls=[[0.9]], gains=[[[gain, 0.0]]], lower=lower, **still),
        ).success.all()


def test_feedback_may_be_laid_out_in_memory_as_it_likes():
    model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    table = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    still = {
        "time": [0.0, 0.1, 0.2, 0.3],
        "states": np.zeros((4, model.nx), order="F"),
        "gains": np.zeros((3, 2, model.nx), order="F"),
    }
    ends = [
        tc.rollouts(
            model, 0.3, 0.01, controls=tc.Feedback(controls=given, **still), compiled=True
        ).final
        for given in (table, np.asfortranarray(table))
    ]
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_allclose(
        ends[0][0],
        tc.simulate(model, 0.3, 0.01, control=table, compiled=False).states[-1],
        atol=1e-14,
    )


def test_a_shared_table_and_one_start_serve_all(spring):
    many = tc.rollouts(
        spring, 1.0, 0.01, controls=np.full((4, 1), 1.0) * [[1.0], [2.0], [3.0], [4.0]]
    )
    expected = np.cos(np.sqrt([1.0, 2.0, 3.0, 4.0]))  # x'' = -u x
    np.testing.assert_allclose(many.final[:, 0], expected, atol=1e-8)
    shared = tc.rollouts(spring, 1.0, 0.01, np.tile([1.0, 0.0], (3, 1)), np.ones((1, 2, 1)))
    np.testing.assert_array_equal(shared.final, np.tile(many.final[0], (3, 1)))


@pytest.mark.parametrize("n", [0, 1, 9])
def test_any_number(spring, n):
    many = tc.rollouts(spring, 0.1, 0.01, np.tile([1.0, 0.0], (n, 1)), save_every=5)
    assert many.states.shape == (n, 3, 2)
    assert many.success.shape == many.message.shape == (n,)
    assert many.success.all()
    assert f"{n} of {n} motions" in many.summary()


def test_a_motion_that_fails_says_why_and_fails_alone(prism):
    x = starts(prism, 4)
    alone = tc.rollouts(prism, T_END, STEP, x, save_every=5)
    x[0, 3] = np.nan
    x[1, prism.nq :] *= 1e5
    x[3, 0] += 0.01
    many = tc.rollouts(prism, T_END, STEP, x, save_every=5)
    assert many.success.tolist() == [False, False, True, True]
    assert many.message[0] == "the start is not one: the state is not finite"
    assert many.message[1].startswith("diverged between t = ")
    assert "the start is off the lengths of its bars" in many.message[3]
    np.testing.assert_array_equal(many.states[2], alone.states[2])
    assert np.isnan(many.final[:2]).all()
    x[0, 3] = 1e101
    assert (
        tc.rollouts(prism, T_END, STEP, x).message[0]
        == "the start is not one: the state is beyond any physical size"
    )
    x[3, 0] += 2.0
    assert tc.rollouts(prism, T_END, STEP, x).success.tolist() == [False, False, True, False]


def test_steps_above_the_stability_limit_are_told():
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=[0, 1.0],
        pinned={0: "xyz", 1: "yz"},
        stiffness=1e3,
        damping=1e5,
        rest_length=0.9,
    )
    model = tc.Model(tc.Scene(structure))
    run = tc.simulate(model, 1.0, 0.01, compiled=False)
    many = tc.rollouts(model, 1.0, 0.01, np.array([[1.0, 0.0], [1.1, 0.0]]), verify=True)
    assert not run.success
    assert not many.success.any()
    assert all(
        "above the stability limit" in message or "diverged" in message for message in many.message
    )


def test_without_cpp_it_goes_one_by_one(prism, monkeypatch):
    x, u = starts(prism, 3), controls(prism, 3, 2)
    code = tc.rollouts(prism, T_END, STEP, x, u, save_every=10, compiled=True)

    def refuse(*_, build):
        raise CompileError("no C++")

    monkeypatch.setattr(kernel_module, "compile_library", refuse)
    slow = tc.rollouts(copy.copy(prism), T_END, STEP, x, u, save_every=10, threads=2)
    np.testing.assert_array_equal(slow.states, code.states)
    np.testing.assert_allclose(slow.energy_error, code.energy_error, atol=1e-12)
    assert slow.lanes == 0
    assert code.lanes in (2, 4, 8)
    assert "one by one, 2 threads" in slow.summary()


def test_files(prism, tmp_path):
    many = tc.rollouts(prism, T_END, STEP, starts(prism, 3), save_every=10)
    loaded = tc.Rollouts.load(many.save(tmp_path / "many.npz"))
    assert repr(loaded) == repr(many)
    np.testing.assert_array_equal(loaded.states, many.states)
    assert loaded.message.tolist() == many.message.tolist()
    content = dict(np.load(tmp_path / "many.npz"))
    for name, value, told in (
        ("states", content["states"][:, :1], "'states'"),
        ("time", content["time"][::-1], "'time' does not increase"),
        ("step", np.asarray(np.inf), "'step' is inf: it must be at least 0, and finite"),
        ("energy_error", -1 - content["energy_error"], "'energy_error' holds a value below 0"),
        ("place", content["place"] + 100, "'place' holds indices"),
        ("energy", content["energy"] * np.nan, "'energy' is not finite"),
        ("message", np.arange(3), "'message' holds values of type"),
        ("format", "else", "'format'"),
    ):
        np.savez(tmp_path / "bad.npz", **{**content, name: value})
        with pytest.raises(ValueError, match=told):
            tc.Rollouts.load(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            {"states": np.zeros(3)},
            r"states has shape \(3,\): give states of shape \(n, 36\) or \(36,\)",
        ),
        ({"states": "x"}, "states is not an array"),
        ({"controls": np.zeros((2, 3))}, "controls has shape"),
        ({"controls": np.full(9, np.nan)}, r"controls\[0\] is nan"),
        (
            {"controls": np.zeros(9)},
            r"controls\[0\] is 0: rest lengths \(RestLength\) must be greater than 0",
        ),
        (
            {"states": np.zeros((2, 36)), "controls": np.ones((3, 9))},
            "states has 2 rows, controls has 3 rows",
        ),
        ({"scheme": tc.RungeKutta4}, "scheme is"),
        ({"correction": 3}, "correction is 3"),
        ({"save_every": 0}, "save_every is 0"),
        ({"threads": 0}, "threads is 0"),
        ({"t_end": -1.0}, "t_end is -1"),
        ({"step": 0.0}, "step is 0"),
        ({"progress": 1}, "progress is 1"),
        (
            {"states": np.zeros((10**6, 36)), "t_end": 1000.0, "step": 1e-5, "save_every": 1},
            "save_every is 1: .*rows take .* GB",
        ),
    ],
)
def test_wrong_arguments(prism, arguments, told):
    with pytest.raises((TypeError, ValueError), match=told):
        tc.rollouts(prism, **{"t_end": 0.1, **arguments})


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"time": [0.0, 0.0, 1.0]}, "Feedback.time"),
        ({"controls": np.ones((3, 1))}, "Feedback.controls"),
        ({"gains": np.ones((2, 1, 3))}, "Feedback.gains"),
        ({"lower": [1.0, 2.0]}, "Feedback.lower"),
        ({"lower": np.nan}, "Feedback.lower"),
        ({"lower": 2.0, "upper": 1.0}, r"Feedback.lower\[0\] is 2, above"),
    ],
)
def test_wrong_feedback(change, told):
    right = {
        "time": [0.0, 0.5, 1.0],
        "controls": np.ones((2, 1)),
        "states": np.ones((3, 2)),
        "gains": np.ones((2, 1, 2)),
    }
    tc.Feedback(**right)
    with pytest.raises(ValueError, match=told):
        tc.Feedback(**{**right, **change})


def test_feedback_of_another_model(prism, spring):
    feedback = tc.Feedback([0.0, 1.0], np.ones((1, 1)), np.ones((2, 2)), np.ones((1, 1, 2)))
    tc.rollouts(spring, 0.1, 0.01, controls=feedback)
    with pytest.raises(
        ValueError,
        match="controls is a Feedback of 1 controls and 2 states: the model has 9 and 36",
    ):
        tc.rollouts(prism, 0.1, controls=feedback)


@pytest.mark.usefixtures("keyboard")
def test_ctrl_c_keeps_what_has_arrived(spring):
    """Motions of which each takes a minute are interrupted at once."""
    tc.rollouts(spring, 1e-3, 1e-3, controls=np.ones(1))  # compiled before
    timer = threading.Timer(0.5, signal.raise_signal, [signal.SIGINT])
    timer.start()
    many = tc.rollouts(spring, 1e5, 1e-3, np.tile([1.0, 0.0], (100, 1)), np.ones(1))
    timer.join()
    assert many.interrupted
    assert not many.success.any()
    assert many.message[0].startswith("interrupted from the keyboard, ")
    assert many.seconds < 10


def test_what_ends_the_wait_stops_the_threads_first(spring, monkeypatch):
    """Steps that go on would write into memory that nobody holds any more."""

    def full(*_):
        raise OSError("no space left")

    monkeypatch.setattr(tqdm, "update", full)
    before = threading.active_count()
    with pytest.raises(OSError, match="no space left"):
        tc.rollouts(
            spring,
            t_end=1e6,
            step=1e-3,
            states=np.tile([1.0, 0.0], (20, 1)),
            controls=np.ones(1),
            threads=2,
            progress=True,
            compiled=False,  # no thread that compiles
        )
    assert threading.active_count() <= before + 1  # the bar's own


def test_progress_counts_all_steps(spring, capsys):
    tc.rollouts(spring, 1.0, 0.01, np.tile([1.0, 0.0], (10, 1)), progress=True)
    assert "1.00k/1.00k" in capsys.readouterr().err


def test_parameters_differ_from_motion_to_motion():
    """Mass, stiffness and gravity of a falling ball, each motion against `simulate` of a model that has them built in."""
    structure = tc.shapes.six_bar_ball(stiffness=800.0, prestress=5.0)
    options = {"gravity": tc.Gravity(), "ground": tc.Ground(height=-0.5, friction=0.5)}
    model = tc.Model(
        tc.Scene(
            structure,
            **options,
            parameters=tc.Parameters(
                "bar_mass", "gravity", scale=["stiffness"], groups={"bar_mass": [list(range(6))]}
            ),
        )
    )
    rng = np.random.default_rng(3)
    mass, pull, stiff = (
        rng.uniform(0.5, 2.0, (5, 1)),
        rng.normal(0, 5, (5, 3)),
        rng.uniform(0.5, 2.0, (5, 1)),
    )
    many = tc.rollouts(
        model,
        0.02,
        1e-3,
        parameters={"bar_mass": mass, "gravity": pull, "stiffness": stiff},
        correction=tc.Projection(),
    )
    table = np.hstack([mass, pull, stiff])
    np.testing.assert_array_equal(
        tc.rollouts(model, 0.02, 1e-3, parameters=table, correction=tc.Projection()).states,
        many.states,
    )
    for k in range(5):
        own = structure.replace(bar_mass=mass[k, 0], stiffness=800.0 * stiff[k, 0])
        alone = tc.Model(tc.Scene(own, **{**options, "gravity": tc.Gravity(pull[k])}))
        run = tc.simulate(alone, 0.02, 1e-3, correction=tc.Projection(), compiled=False)
        np.testing.assert_allclose(many.final[k], run.states[-1], rtol=0, atol=1e-11)
        same = tc.simulate(
            model, 0.02, 1e-3, parameters=table[k], correction=tc.Projection(), compiled=False
        )
        np.testing.assert_array_equal(many.final[k], same.states[-1])
    none = tc.rollouts(model, 0.02, 1e-3, parameters=table[:0])
    assert none.states.shape == (0, 2, model.nx)
    with pytest.raises(
        ValueError, match=r"parameters\[2\]: bar_mass of bar 0 is -1 kg: it must be greater than 0"
    ):
        tc.rollouts(model, 0.02, parameters={"bar_mass": [[1.0], [1.0], [-1.0]]})
    with pytest.raises(
        ValueError, match=r"parameters\['bar_mass'\] has 2 rows, parameters\['gravity'\] has 5 rows"
    ):
        tc.rollouts(model, 0.02, parameters={"bar_mass": mass[:2], "gravity": pull})
    with pytest.raises(ValueError, match="damping"):
        tc.rollouts(model, 0.02, parameters={"damping": mass})


def test_values_of_parameters_take_no_second_compilation(monkeypatch):
    model = tc.Model(tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("stiffness")))
    counted = []
    monkeypatch.setattr(
        kernel_module,
        "compile_library",
        lambda *given, own=kernel_module.compile_library, **how: (
            counted.append(given) or own(*given, **how)
        ),
    )
    for k in range(3):
        many = tc.rollouts(
            model,
            0.01,
            parameters=model.parameters.nominal * (1 + np.arange(4 + k)[:, None]),
            compiled=True,
        )
        assert many.success.all()
    assert len(counted) == 1


def test_what_changes_faster_than_any_steps_is_told_and_not_trusted() -> None:
    structure = tc.Structure([(0, 0, 0)], node_mass=1.0)
    model = tc.Model(tc.Scene(structure, forces=tc.NodalForce(lambda t: [[np.sin(2e6 * t), 0, 0]])))
    many = tc.rollouts(model, 1.0, 0.01)
    assert not many.success.any()
    assert "NodalForce.values changes within steps near t = " in many.message[0]


@pytest.mark.slow
def test_each_motion_whose_energy_is_lost_is_no_success() -> None:
    """Masses bounce on ground that is stiff for the step: also where many of them lose or gain more than half of what moves."""
    mass = tc.Structure([(0, 0, 0.5)], node_mass=1.0)
    model = tc.Model(
        tc.Scene(
            mass, gravity=tc.Gravity(), ground=tc.Ground(stiffness=1e5, damping=0.0, friction=None)
        )
    )
    states = np.array([model.state([[0, 0, height]]) for height in np.linspace(0.3, 3.0, 64)])
    many = tc.rollouts(model, t_end=20.0, step=8.5e-3, states=states, save_every=1)
    alone = [
        tc.simulate(model, 20.0, 8.5e-3, state=state, save_every=1, compiled=False, verify=False)
        for state in states
    ]  # the repetition in other steps fails nearly all of them
    assert many.success.tolist() == [run.success for run in alone]
    assert 40 < many.success.sum() < 60


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_rollers_along_any_direction(coordinates, tmp_path):
    feet = tc.shapes.prism(prestress=20.0).replace(
        pinned={0: "z", 1: "xyz"}, rollers={2: [(0.6, 0.0, 0.8)]}
    )
    model = tc.Model(tc.Scene(feet, gravity=tc.Gravity((0.0, 0.0, -1.0))), coordinates)
    given = np.tile(model.initial_state, (3, 1))
    given[:, model.nq :] = np.random.default_rng(0).normal(0, 0.3, (3, model.nq))
    x0 = tc.build_projection(model).map(3)(given.T).full().T
    many = tc.rollouts(model, T_END, STEP, x0, save_every=5)
    tc.Rollouts.load(many.save(tmp_path / "many.npz"))
    for k, x in enumerate(x0):
        run = tc.simulate(model, T_END, STEP, state=x, save_every=5, compiled=False)
        np.testing.assert_array_equal(many.states[k], run.states)
        assert (many.success[k], many.message[k]) == (run.success, run.message)
        for given in (many, tc.Rollouts.load(tmp_path / "many.npz")):
            for node in range(6):
                np.testing.assert_allclose(given.path(node)[k], run.nodes[:, node], atol=1e-15)
    moved = many.path(2) - feet.nodes[2]
    assert abs(moved).max() > 1e-4
    assert abs(moved @ (0.6, 0.0, 0.8)).max() < 1e-15
