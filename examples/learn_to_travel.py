"""A ball of six bars learns to travel: rhythms of its strings are tried side by side in a vector environment of gymnasium, and the best bred.

Each string is wound and let out as a sine with an amplitude and a phase of its own. A generation of
rhythms is one vector environment, an episode for each; ground and masses differ from episode to
episode. The cross-entropy method goes on from the best tenth.

It also measures decisions and steps per second, of one environment and of 1024.

Needs gymnasium: pip install 'tenscasadi[gym]'. Run it with a folder for the picture: python
examples/learn_to_travel.py pictures
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import tenscasadi as tc
from tenscasadi.envs import Task, TensegrityEnv, TensegrityVectorEnv, Transition

PERIOD, STEPS, DURATION = 0.05, 25, 3.0  # s between decisions, steps in between, s of an episode
FREQUENCY = 1.5  # Hz
RATE = 0.5  # m/s, of rest lengths


class Learned(NamedTuple):
    """Distances, m, of all rhythms of each generation (generations, n), and (environments, decisions per second)."""

    distance: np.ndarray
    speeds: list[tuple[int, float]]


def main(folder: Path = Path(), quick: bool = False) -> Learned:
    """Prints the progress and the speed, saves the picture, and returns both."""
    folder.mkdir(parents=True, exist_ok=True)
    task = Task(
        ball(),
        forward,
        lower=0.2,
        upper=1.0,
        rest_length_rate=RATE,
        period=PERIOD,
        steps=STEPS,
        duration=DURATION,
        start=0.005,
        parameters={"ground_stiffness": 0.3, "bar_mass": 0.1},
    )
    distance = learn(task, generations=3 if quick else 15, count=64 if quick else 128)
    for k, row in enumerate(distance):
        print(
            f"generation {k:2d}: median {np.median(row):5.2f} m, best {row.max():5.2f} m in {DURATION:g} s"
        )
    speeds = [measure(task, count, 20 if quick else 100) for count in (1, 1024)]
    for count, speed in speeds:
        print(
            f"{count:5d} environments: {speed:9.0f} decisions, {speed * STEPS / 1e6:.2f} million steps per second"
        )
    draw(distance, folder / "learn_to_travel.png")
    return Learned(distance, speeds)


def ball() -> tc.Model:
    """The ball on a face, with strings that are wound."""
    structure = tc.shapes.six_bar_ball(stiffness=1000.0, damping=5.0, prestress=100.0)
    face = structure.nodes[[11, 3, 7]].sum(axis=0)
    x = structure.nodes[[3, 7]].mean(axis=0) - structure.nodes[11]
    x, z = x / np.linalg.norm(x), -face / np.linalg.norm(face)
    nodes = structure.nodes @ np.array([x, np.cross(z, x), z]).T
    standing = structure.replace(nodes=nodes - [0, 0, nodes[:, 2].min()])
    ground = tc.Ground(stiffness=5e3, damping=50.0, friction=0.7, slip_speed=0.05)
    varied = tc.Parameters("ground_stiffness", scale=["bar_mass"])
    return tc.Model(
        tc.Scene(
            standing,
            control=tc.RestLength(),
            gravity=tc.Gravity(),
            ground=ground,
            parameters=varied,
        )
    )


def forward(now: Transition) -> np.ndarray:
    """The reward: meters that the center moves along x."""
    return np.asarray((now.nodes - now.nodes_before)[:, :, 0].mean(axis=1))


def learn(task: Task, generations: int, count: int) -> np.ndarray:
    """Cross-entropy method over sine and cosine of each string; returns distances (generations, count)."""
    envs = TensegrityVectorEnv(task, count)
    rng = np.random.default_rng(0)
    mean, spread = np.zeros((2, task.model.nu)), np.full((2, task.model.nu), 0.5)
    found = []
    for generation in range(generations):
        rhythms = mean + spread * rng.standard_normal((count, 2, task.model.nu))
        envs.reset(seed=generation)
        distance, alive = np.zeros(count), np.ones(count, dtype=bool)
        for k in range(task.decisions):
            angle = 2 * np.pi * FREQUENCY * PERIOD * k
            _, rewards, terminated, _, _ = envs.step(
                rhythms[:, 0] * np.sin(angle) + rhythms[:, 1] * np.cos(angle)
            )
            distance += np.where(alive, rewards, 0.0)
            alive &= ~terminated
        best = rhythms[np.argsort(distance)[-count // 10 :]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.02
        found.append(distance)
    return np.array(found)


def measure(task: Task, count: int, decisions: int) -> tuple[int, float]:
    """Decisions per second of one environment, or of many."""
    env = TensegrityEnv(task) if count == 1 else TensegrityVectorEnv(task, count)
    env.reset(seed=0)
    action = 0.1 * env.action_space.sample()
    seconds = []
    for k in range(decisions):
        if k % task.decisions == 0:
            env.reset()
        began = time.perf_counter()
        env.step(action)
        seconds.append(time.perf_counter() - began)
    return count, count / float(np.median(seconds))


def draw(distance: np.ndarray, path: Path) -> None:
    """Distances over generations."""
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    ax = figure.subplots()
    for shares, alpha in (((0.0, 1.0), 0.15), ((0.25, 0.75), 0.3)):
        ax.fill_between(
            np.arange(len(distance)),
            *np.quantile(distance, shares, axis=1),
            color="tab:blue",
            alpha=alpha,
            lw=0,
        )
    ax.plot(
        np.median(distance, axis=1),
        color="tab:blue",
        label="median; half and all of the rhythms shaded",
    )
    ax.set(
        xlabel="generation",
        ylabel=f"way along x in {DURATION:g} s (m)",
        title="a six-bar ball learns to travel",
    )
    ax.legend(frameon=False, loc="upper left")
    ax.grid(visible=True, color="0.9")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))
