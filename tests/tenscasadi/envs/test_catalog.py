"""Ready-made environments: their names, gymnasium's checks, pictures, and learning."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tenscasadi.envs import TensegrityEnv, TensegrityVectorEnv, catalog

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def registered():
    """The environments as gymnasium registers them by the entry point of the package."""
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 reads no TOML")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ((name, value),) = project["entry-points"]["gymnasium.envs"].items()
    for known in [known for known in gymnasium.registry if known.startswith("tenscasadi/")]:
        del gymnasium.registry[known]
    with gymnasium.envs.registration.namespace(name):
        EntryPoint(name, value, "gymnasium.envs").load()()


@pytest.mark.parametrize("name", ["tenscasadi/PrismJump-v0", "tenscasadi/BallTravel-v0"])
def test_gymnasium_makes_and_checks_the_task(name):
    env = gymnasium.make(name)
    assert isinstance(env.unwrapped, TensegrityEnv)
    check_env(env.unwrapped, skip_render_check=True)


def test_gymnasium_finds_nothing_in_pictures():
    pytest.importorskip("viser", reason="tenscasadi[view] is not installed")
    check_env(gymnasium.make("tenscasadi/PrismJump-v0").unwrapped)


def test_vector_environment_is_made_by_name():
    envs = gymnasium.make_vec("tenscasadi/PrismJump-v0", num_envs=3)
    assert isinstance(envs.unwrapped, TensegrityVectorEnv)
    assert envs.reset(seed=0)[0].shape[0] == 3


def test_picture_changes_with_the_state():
    env = gymnasium.make("tenscasadi/BallTravel-v0", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    for _ in range(5):
        env.step(np.ones(env.action_space.shape))
    second = env.render()
    assert first.shape == second.shape == (400, 480, 3)
    assert first.dtype == np.uint8
    assert np.mean(np.any(first != second, axis=2)) > 0.01
    assert np.mean(first < 128) > 0.002  # bars are dark
    assert env.metadata["render_fps"] == 20


def test_human_mode_shows_every_period(monkeypatch):
    pytest.importorskip("viser", reason="tenscasadi[view] is not installed")
    env = TensegrityEnv(catalog.build_prism_jump(), "human")
    shown = []
    monkeypatch.setattr(env._renderer, "draw", shown.append)
    env.reset(seed=0)
    env.step(np.zeros(9))
    assert [frame.time for frame in shown] == [0.0, pytest.approx(0.05)]
    env.close()
    assert env.render() is None


def test_render_mode_that_is_unknown_is_rejected():
    with pytest.raises(ValueError, match="render_mode is 'ansi': give 'rgb_array'"):
        TensegrityEnv(catalog.build_prism_jump(), "ansi")


@pytest.mark.slow
def test_cross_entropy_method_learns_to_jump():
    envs = gymnasium.make_vec("tenscasadi/PrismJump-v0", num_envs=64)
    periods, rng = 20, np.random.default_rng(0)
    mean, spread = np.zeros((4, 9)), np.ones((4, 9))  # rates in four quarters of the episode
    medians = []
    for generation in range(12):
        rates = mean + spread * rng.standard_normal((64, 4, 9))
        envs.reset(seed=generation)
        returns, alive = np.zeros(64), np.ones(64, dtype=bool)
        for k in range(periods):
            _, rewards, terminated, _, _ = envs.step(np.clip(rates[:, k // 5], -1, 1))
            returns += np.where(alive, rewards, 0.0)
            alive &= ~terminated
        elite = rates[np.argsort(returns)[-8:]]
        mean, spread = elite.mean(axis=0), elite.std(axis=0) + 0.05
        medians.append(np.median(returns))
    print(medians)
    assert medians[-1] > medians[0] + 0.02  # mean height of the center over the episode, m
