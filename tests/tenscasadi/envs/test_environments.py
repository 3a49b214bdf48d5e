"""Environments: gymnasium's own checks, and motions as `simulate` makes them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv

import tenscasadi as tc
from tenscasadi.envs import Task, TensegrityEnv, TensegrityVectorEnv

ROOT = Path(__file__).resolve().parents[3]
PRISM = tc.shapes.prism(stiffness=500.0, damping=1.0, prestress=50.0)
OPTIONS = {"gravity": tc.Gravity(), "ground": tc.Ground(stiffness=2e3, damping=5.0, friction=0.5)}
PARAMETERS = tc.Parameters("ground_stiffness", scale=["bar_mass"])
DRIVEN, WOUND = (
    tc.Model(tc.Scene(PRISM, control=control, parameters=PARAMETERS, **OPTIONS))
    for control in (tc.ForceDensity(), tc.RestLength())
)
PINNED = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))


def forward(now):
    return (now.nodes - now.nodes_before)[:, :, 0].mean(axis=1)


def driven(**options):
    given = {
        "start": (0.01, 0.05),
        "parameters": {"ground_stiffness": 0.3, "bar_mass": 0.1},
        "duration": 0.5,
        **options,
    }
    return Task(DRIVEN, forward, 5.0, 80.0, **given)


def wound(**options):
    given = {
        "start": (0.01, 0.05),
        "parameters": {"ground_stiffness": 0.3, "bar_mass": 0.1},
        "duration": 0.5,
        **options,
    }
    return Task(WOUND, forward, 0.2, 2.0, rest_length_rate=0.5, **given)


CABLED = tc.shapes.prism(stiffness=500.0, damping=1.0, prestress=50.0).replace(
    cables=[[0, 1], [3, 4]]
)


def with_winches(control, most):
    model = tc.Model(tc.Scene(CABLED, control=control, **OPTIONS))
    return Task(model, forward, -most, most, start=(0.01, 0.05), duration=0.5)


def reeled(**options):
    return with_winches(tc.RestLengthRate(), 0.5)


def motored(**options):
    return with_winches(tc.Winch(0.02, 1e-3, 1e-3), 2.0)


TASKS = {
    "force densities": driven,
    "rest lengths": wound,
    "winding speeds": reeled,
    "motors": motored,
}


def test_winches_follow_their_actions_and_are_observed():
    env = TensegrityEnv(reeled())
    first, _ = env.reset(seed=0)
    before = CABLED.rest_length[CABLED.cable_of == CABLED.cable_of[0]].sum()
    assert env.action_space.shape == (7,)
    assert first.shape == (2 * 18 + 7,)
    assert before == pytest.approx(first[36], rel=1e-6)
    action = np.zeros(7)
    action[0] = -1.0
    seen = env.step(action)[0]
    assert seen[36] == pytest.approx(before - 0.5 * 0.05, rel=1e-6)
    assert seen[37:] == pytest.approx(first[37:], rel=1e-6)


def test_a_string_wound_up_ends_the_episode():
    model = tc.Model(tc.Scene(CABLED, control=tc.RestLengthRate()))
    env = TensegrityEnv(Task(model, forward, -100.0, 100.0, period=0.1, steps=100))
    env.reset(seed=0)
    ended = env.step(-np.ones(7))[2]
    assert ended


@pytest.mark.parametrize("make", TASKS.values(), ids=TASKS)
def test_gymnasium_finds_nothing(make):
    check_env(TensegrityEnv(make()), skip_render_check=True)  # its warnings are errors here


def test_a_registered_environment_is_made_and_checked():
    gymnasium.register("Prism-v0", entry_point=lambda **mode: TensegrityEnv(driven(), **mode))
    env = gymnasium.make("Prism-v0")
    check_env(env.unwrapped, skip_render_check=True)
    del gymnasium.registry["Prism-v0"]


def test_an_episode_moves_as_simulate_says():
    task = driven(parameters={}, start=0.0, correction=None)
    env = TensegrityEnv(task)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, DRIVEN.nu))
    seen = [env.step(action) for action in actions]
    motion = tc.simulate(DRIVEN, 0.2, 0.005, control=5.0 + (actions + 1) / 2 * 75.0, compiled=False)
    for k, (observation, reward, *_) in enumerate(seen):
        now = 10 * (k + 1)
        assert observation == pytest.approx(
            np.concatenate([motion.nodes[now].ravel(), motion.velocities[now].ravel()]),
            rel=1e-5,
            abs=1e-5,
        )
        assert reward == pytest.approx(
            (motion.nodes[now] - motion.nodes[now - 10])[:, 0].mean(), abs=1e-12
        )


def test_rest_lengths_run_on_at_the_rate_of_the_action():
    task = wound(parameters={}, start=0.0, correction=None, steps=5)
    env = TensegrityEnv(task)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (3, WOUND.nu))
    ends = [env.step(action)[0] for action in actions]
    rates = 0.5 * np.repeat(actions, 5, axis=0)
    rest = WOUND.initial_control + 0.01 * (np.cumsum(rates, axis=0) - rates / 2)
    motion = tc.simulate(WOUND, 0.15, 0.01, control=rest, compiled=False)
    size = 3 * len(PRISM.nodes)
    assert ends[-1][:size] == pytest.approx(motion.nodes[-1].ravel(), abs=1e-5)
    assert ends[-1][2 * size :] == pytest.approx(
        WOUND.initial_control + 0.025 * actions.sum(axis=0), abs=1e-6
    )


def test_rest_lengths_stay_within_their_limits():
    env = TensegrityEnv(Task(WOUND, forward, 0.9, 1.1, rest_length_rate=5.0))
    env.reset(seed=0)
    for sign in (1.0, -1.0):
        for _ in range(2):
            seen = env.step(np.full(WOUND.nu, sign))[0]
        assert seen[-WOUND.nu :] == pytest.approx(np.full(WOUND.nu, 1.0 + 0.1 * sign))


def bar_error(env):
    ends = DRIVEN.nodes(env._episodes.states[0])[PRISM.bars]
    return abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / DRIVEN.mechanism.lengths - 1).max()


@pytest.mark.parametrize("steps", [3, 10])
def test_bars_are_put_right_however_few_steps_a_period_has(steps):
    env = TensegrityEnv(driven(steps=steps, period=0.005 * steps))
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.ones(DRIVEN.nu))
    assert bar_error(env) < 1e-12


def test_an_episode_whose_bars_break_is_terminated():
    env = TensegrityEnv(driven(correction=None, period=0.1, steps=5, duration=10.0))
    env.reset(seed=0)
    for _ in range(100):
        _, reward, terminated, _, info = env.step(np.ones(DRIVEN.nu))
        assert bar_error(env) < 0.1
        if terminated:
            break
    assert (reward, info) == (0.0, {"diverged": True})


def test_batched_episodes_equal_single_ones():
    task = driven(start=0.0, parameters={})
    envs, env = TensegrityVectorEnv(task, 5), TensegrityEnv(task)
    actions = np.random.default_rng(1).uniform(-1, 1, (3, 5, DRIVEN.nu)).astype(np.float32)
    envs.reset(seed=0)
    found = [envs.step(action) for action in actions]
    for k in (0, 4):
        env.reset(seed=0)
        for action, (seen, rewards, *_) in zip(actions, found, strict=True):
            one, reward, *_ = env.step(action[k])
            assert np.array_equal(seen[k], one)
            assert rewards[k] == reward


def test_a_vector_environment_is_as_gymnasium_describes_it():
    envs = TensegrityVectorEnv(driven(duration=0.15), 6, threads=2)
    assert isinstance(envs, VectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    first, _ = envs.reset(seed=3)
    assert first in envs.observation_space
    assert envs.single_observation_space.contains(first[0])
    late = []
    for _ in range(8):
        seen, rewards, terminated, truncated, info = envs.step(envs.action_space.sample())
        assert seen in envs.observation_space
        assert (
            rewards.shape == terminated.shape == truncated.shape == info["diverged"].shape == (6,)
        )
        late.append(truncated.all())
    assert late == [
        False,
        False,
        True,
        False,
        False,
        False,
        True,
        False,
    ]  # it begins anew in the fourth
    recorded = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        TensegrityVectorEnv(driven(duration=0.1), 3)
    )
    recorded.reset(seed=0)
    for _ in range(2):
        *_, info = recorded.step(recorded.action_space.sample())
    assert info["episode"]["l"].tolist() == [2, 2, 2]


def test_an_episode_that_begins_anew_is_not_rewarded():
    envs = TensegrityVectorEnv(driven(duration=0.05), 2)
    envs.reset(seed=0)
    _, _, _, truncated, _ = envs.step(envs.action_space.sample())
    assert truncated.all()
    seen, rewards, _, truncated, _ = envs.step(envs.action_space.sample())
    assert rewards.tolist() == [0.0, 0.0]
    assert not truncated.any()
    assert abs(seen[:, : 3 * len(PRISM.nodes)] - PRISM.nodes.ravel()).max() < 0.05  # near the start


def test_episodes_vary_start_and_parameters_within_spreads():
    envs = TensegrityVectorEnv(driven(), 200)
    envs.reset(seed=0)
    p = envs._episodes.parameters
    assert abs(p / [2e3, 1.0] - 1).max(axis=0) == pytest.approx([0.3, 0.1], rel=0.05)
    states = envs._episodes.states
    assert abs(np.ptp(states[:, :3], axis=0) - 0.02).max() < 0.01
    assert max(DRIVEN.bar_length_error(x) for x in states) < 1e-12
    heavy, light = (
        tc.simulate(
            DRIVEN,
            0.05,
            0.005,
            state=states[0],
            control=np.full(9, 42.5),
            correction=tc.Projection(10),
            parameters=row,
            compiled=False,
        )
        for row in p[:2]
    )
    assert abs(heavy.nodes[-1] - light.nodes[-1]).max() > 1e-6
    envs.step(np.zeros((200, 9)))
    assert envs._episodes.states[0] == pytest.approx(heavy.states[-1], abs=1e-10)


def test_the_same_seed_draws_the_same():
    runs = []
    for seed in (1, 1, 2):
        envs = TensegrityVectorEnv(driven(), 4)
        envs.reset(seed=seed)
        runs.append(envs.step(np.zeros((4, 9)))[0])
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_observation_and_termination_are_functions():
    task = driven(
        observation=lambda nodes, velocities, control: nodes[:, :2, 2],
        terminated=lambda now: now.time > 0.12,
    )
    env = TensegrityEnv(task)
    seen, _ = env.reset(seed=0)
    assert seen.shape == (2,)
    assert [env.step(np.zeros(9))[2] for _ in range(3)] == [False, False, True]


def overwrite(array):
    array[:] = 7.0
    return array


@pytest.mark.parametrize(
    "name", ["nodes", "velocities", "nodes_before", "velocities_before", "control", "action"]
)
def test_a_reward_cannot_change_the_motion(name):
    env = TensegrityEnv(Task(DRIVEN, lambda now: overwrite(getattr(now, name)), 5.0, 80.0))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"Task.reward fails with ValueError: .*read-only"):
        env.step(np.zeros(9))


def test_an_observation_cannot_change_the_motion():
    with pytest.raises(ValueError, match=r"Task.observation fails with ValueError: .*read-only"):
        TensegrityEnv(driven(observation=lambda nodes, velocities, control: overwrite(nodes)[:, 0]))


def test_observation_of_changing_size_is_rejected():
    seen = []

    def more(nodes, velocities, control):
        seen.append(0.0)
        return np.zeros((len(nodes), 1 + len(seen) // 3))

    env = TensegrityEnv(driven(observation=more))
    env.reset(seed=0)
    with pytest.raises(
        ValueError,
        match=r"result of Task.observation has shape \(1, 2\): give an array of shape \(1, 1\)",
    ):
        env.step(np.zeros(9))


def test_some_episodes_begin_anew_where_a_mask_says_so():
    envs = TensegrityVectorEnv(driven(), 3)
    envs.reset(seed=0)
    before = envs.step(np.ones((3, 9)))[0]
    mask = np.array([False, True, False])
    seen, _ = envs.reset(options={"reset_mask": mask})
    assert np.array_equal(seen[~mask], before[~mask])
    assert abs(seen[1, : 3 * len(PRISM.nodes)] - PRISM.nodes.ravel()).max() < 0.05  # near the start
    assert envs._episodes.decided.tolist() == [1, 0, 1]
    with pytest.raises(
        ValueError,
        match=r"options\['reset_mask'\] is int64 of shape \(2,\): give bool of shape \(3,\)",
    ):
        envs.reset(options={"reset_mask": np.array([1, 0])})


def test_an_episode_that_diverges_ends():
    wild = Task(DRIVEN, forward, 0.0, 1e30, steps=1, correction=None)
    envs = TensegrityVectorEnv(wild, 3)
    envs.reset(seed=0)
    actions = np.full((3, 9), -1.0)
    actions[1] = 1.0
    seen, rewards, terminated, _, info = envs.step(actions)
    assert terminated.tolist() == info["diverged"].tolist() == [False, True, False]
    assert rewards[1] == 0.0
    assert np.all(np.isfinite(seen))
    assert not envs.step(-np.ones((3, 9)))[2].any()


BAD = {
    "no task": (lambda: TensegrityEnv(DRIVEN), TypeError, "task is"),
    "environments beyond memory": (
        lambda: TensegrityVectorEnv(driven(), 10**9),
        ValueError,
        r"num_envs is 1e\+09: it must be at most",
    ),
    "starts that break bars": (
        lambda: TensegrityVectorEnv(Task(PINNED, forward, 0.0, 9.0, start=1e6), 3).reset(seed=0),
        ValueError,
        "Task.start is .*: the projection of such starts",
    ),
    "no environments": (lambda: TensegrityVectorEnv(driven(), 0), ValueError, "num_envs"),
    "actions of other strings": (
        lambda: TensegrityEnv(driven()).step(np.zeros(4)),
        ValueError,
        r"action has shape \(4,\): give \(9,\)",
    ),
    "actions that are text": (
        lambda: TensegrityEnv(driven()).step("right"),
        TypeError,
        "action is not an array of real numbers",
    ),
    "actions that are no numbers": (
        lambda: TensegrityEnv(driven()).step(np.full(9, np.nan)),
        ValueError,
        "finite numbers",
    ),
    "a reward of other shape": (
        lambda: TensegrityEnv(Task(DRIVEN, lambda now: 1.0, 0.0, 1.0)).step(np.zeros(9)),
        ValueError,
        r"result of Task.reward has shape \(\): give .*\(1,\)",
    ),
    "a reward that fails": (
        lambda: TensegrityEnv(Task(DRIVEN, lambda now: now.speed, 0.0, 1.0)).step(np.zeros(9)),
        ValueError,
        "Task.reward.*has no attribute 'speed'.*give a function of a Transition",
    ),
    "an observation of other shape": (
        lambda: TensegrityEnv(driven(observation=lambda nodes, velocities, control: nodes)),
        ValueError,
        "result of Task.observation has shape",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_arguments_are_rejected_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()


def test_envs_name_gymnasium_if_it_is_missing():
    code = "import sys, tenscasadi, ocp; assert 'gymnasium' not in sys.modules; sys.modules['gymnasium'] = None; import tenscasadi.envs"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (
        "ImportError: tenscasadi.envs needs gymnasium: pip install 'tenscasadi[gym]'" in done.stderr
    )


ROPE = tc.Structure(
    [(0, 0, 0), (0, 0, -1)],
    strings=[(0, 1)],
    pinned=[0],
    node_mass=[0.0, 1.0],
    stiffness=1e3,
    rest_length=0.99,
    damping=5.0,
)


@pytest.mark.parametrize("ends", [False, True])
@pytest.mark.parametrize("strength", [tc.Breaking(30.0), tc.Yielding(12.0, viscosity=50.0)])
def test_strings_fail_in_episodes(strength, ends):
    """The first action winds up the string, the second one holds it."""
    scene = tc.Scene(ROPE, control=tc.RestLength(), gravity=tc.Gravity(), strength=strength)
    limits = {"lower": 0.5, "upper": 1.2, "rest_length_rate": 2.0}
    task = Task(
        tc.Model(scene),
        lambda now: now.nodes[:, 1, 2],
        **limits,
        period=0.05,
        end_on_failure=np.bool_(ends),
    )
    envs = TensegrityVectorEnv(task, 2)
    envs.reset(seed=0)
    terminated = np.zeros(2, dtype=bool)
    for _ in range(4):
        seen, rewards, ended, _, _ = envs.step(np.array([[-1.0], [0.0]], dtype=np.float32))
        terminated |= ended
        assert np.isfinite(seen).all()
        assert np.isfinite(rewards).all()
    assert terminated.tolist() == [ends, False]
