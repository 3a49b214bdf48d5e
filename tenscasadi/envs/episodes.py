"""Batch simulation of the episodes of a control task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.envs.task import Task, Transition, read_spread
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.scene.failed_strings import find_failed
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.simulation.engine.kernel import BROKEN_BARS
from tenscasadi.structure.class_one import distances
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, call_user_function, finite_array

FARTHEST = 1e6  # m, m/s: limit of observations, because spaces must be bounded


class Episodes:
    """Batch of `count` episodes of a control task.

    Attributes
    ----------
    states : ndarray, shape (n, nx)
        States.
    control : ndarray, shape (n, nu)
        Controls.
    parameters : ndarray, shape (n, np)
        Parameters of each episode.
    decided : ndarray of int, shape (n,)
        Number of control periods so far.
    """

    def __init__(self, task: Task, count: int, threads: int = 1) -> None:
        self.task, self.threads = task, threads
        model = task.model
        self._first, self._start = (
            np.array(task.state, dtype=float),
            read_spread("Task.start", task.start),
        )
        self.states, self.control = (
            np.tile(self._first, (count, 1)),
            np.tile(model.initial_control, (count, 1)),
        )
        self.parameters, self.decided = (
            np.repeat(model.parameters.nominal[None], count, axis=0),
            np.zeros(count, dtype=int),
        )
        correction = task.correction and replace(  # type: ignore[type-var]  # all are dataclasses
            task.correction, every=min(task.correction.every, task.steps)
        )  # the count restarts in each period
        self._kernel = build_kernel(model, RungeKutta4(), correction)
        self._project = ArrayFunction(build_projection(model, 10))
        self._spread = task.spread
        parts = model.scene.internal_states
        self._least = np.concatenate(
            [np.zeros(0), *(np.full(len(part.scale), part.least) for part in parts)]
        )
        self._width: int | None = None
        self.nodes, self.velocities = self._places(self.states)

    def reset(self, which: Any, rng: np.random.Generator) -> None:
        """Restart the episodes with the indices `which`.

        `rng` draws the random variations. Raises ValueError if the spread violates bar lengths.
        """
        task, model = self.task, self.task.model
        self.control = self.control.copy()
        for k in which:
            self.parameters[k] = p = model.parameters.nominal + self._spread * rng.uniform(
                -1, 1, model.np
            )
            x = self._first.copy()
            model.split(x).internal[:] += model.internal_at(p) - model.internal_at(
                model.parameters.nominal
            )
            if any(self._start):
                q, v, *_ = model.split(x)
                q += self._start[0] * rng.uniform(-1, 1, model.nq)
                v += self._start[1] * rng.uniform(-1, 1, model.nq)
                x = self._project(x, p)[0].ravel() if model.np else self._project(x)[0].ravel()
            self.states[k] = x
            self.control[k] = np.clip(model.control_at(p), *task.limits)
        self.decided[which] = 0
        nodes, velocities = self._places(self.states[which])
        if self._find_broken(nodes).any():
            raise ValueError(
                f"Task.start is {task.start}: the projection of such starts onto bars and joints fails, give a smaller spread"
            )
        self.nodes, self.velocities = (
            self.nodes.copy(),
            self.velocities.copy(),
        )  # arrays of earlier transitions must not change
        self.nodes[which], self.velocities[which] = nodes, velocities

    def step(self, action: Array) -> tuple[Transition, Array]:
        """Simulate one control period of all episodes.

        Actions (n, α) run from −1 to 1. Also returns which episodes diverged (n,).
        """
        task = self.task
        inputs = self._inputs(action)
        rolled = self._kernel(
            self.states,
            inputs,
            task.period / task.steps,
            task.steps // inputs.shape[1],
            threads=self.threads,
        )
        before = self.nodes, self.velocities
        after = self._places(rolled.states)
        lost = (rolled.status != 0) | self._find_broken(after[0])
        lost |= np.any(task.model.split(rolled.states).internal < self._least, axis=1)
        self.states = np.where(lost[:, None], self.states, rolled.states)
        self.nodes, self.velocities = (
            np.where(lost[:, None, None], *places) for places in zip(before, after, strict=True)
        )
        self.decided = self.decided + 1
        now = (
            self.nodes,
            self.velocities,
            *before,
            self.control,
            action,
            self.decided * task.period,
        )
        return Transition(*map(_read_only, now)), lost

    def observe(self) -> Any:
        """Compute the observations (n, k), in single precision."""
        task, n = self.task, len(self.states)
        if task.observation is not None:
            cure = "give a function of nodes (n, N, 3), velocities (n, N, 3) and control (n, α) that returns (n, k)"
            see = task.observation
            places = tuple(map(_read_only, (self.nodes, self.velocities, self.control)))
            given = call_user_function(
                "Task.observation", lambda places: see(*places), places, cure
            )
            seen = finite_array("result of Task.observation", given, (n, self._width))
            self._width = seen.shape[1]  # the size of the observation space
        else:
            rows = [
                self.nodes.reshape(n, -1),
                self.velocities.reshape(n, -1),
                *([self.control] if task.controls_rest_lengths else []),
                task.model.split(self.states).internal,
            ]
            seen = np.concatenate(rows, axis=1)
        return np.clip(seen, -FARTHEST, FARTHEST).astype(np.float32)

    def rewards(self, now: Transition, lost: Array) -> Array:
        """Compute the rewards (n,), which are 0 for diverged episodes.

        `now` is the transition of all episodes, and `lost` (n,) marks the diverged ones.
        """
        return np.where(lost, 0.0, _per_episode("reward", self.task.reward, now))

    def find_ended(self, now: Transition, lost: Array) -> Any:
        """Return a mask (n,) of the episodes that have terminated.

        `now` is the transition of all episodes, and `lost` (n,) marks the diverged ones.
        """
        ended = lost.copy()
        if self.task.end_on_failure:
            internal = self.task.model.split(self.states).internal
            ended = lost | find_failed(self.task.model.scene, internal).any(axis=1)
        if self.task.terminated is None:
            return ended
        return ended | (_per_episode("terminated", self.task.terminated, now) != 0)

    def _places(self, states: Array) -> tuple[Array, Array]:
        """Compute node positions and velocities, each (n, N, 3).

        They are in m and m/s. The states are (n, nx).
        """
        count = len(self.task.model.scene.structure.nodes)
        return self.task.model.nodes(states)[:, :count], self.task.model.velocities(states)[
            :, :count
        ]

    def _find_broken(self, nodes: Array) -> Any:
        """Return which episodes (n,) have large bar-length errors.

        The result is a mask. The nodes are (n, N, 3) [m].
        """
        structure = self.task.model.scene.structure
        lengths = structure.bar_lengths
        error = np.abs(distances(nodes, structure.bars) - lengths)
        return np.any(error > BROKEN_BARS * lengths, axis=1)

    def _inputs(self, action: Array) -> Array:
        """Build the inputs (n, intervals, nw) of one period.

        The actions are (n, nu) from −1 to 1. Rest lengths change in every step.
        """
        task, model = self.task, self.task.model
        n, pieces = len(action), task.steps if task.controls_rest_lengths else 1
        inputs = np.empty((n, pieces, model.nw))
        inputs[:, :, model.nu :] = self.parameters[:, None]
        lower, upper = task.limits
        if task.controls_rest_lengths:
            share = (np.arange(pieces) + 0.5) / pieces
            change = action * np.asarray(task.rest_length_rate, dtype=float) * task.period
            rest = inputs[:, :, : model.nu]
            np.multiply(share[:, None], change[:, None], out=rest)
            rest += self.control[:, None]
            np.clip(rest, lower, upper, out=rest)
            self.control = np.clip(self.control + change, lower, upper)
        else:
            self.control = lower + (action + 1) / 2 * (upper - lower)
            inputs[:, 0, : model.nu] = self.control
        return inputs


def _read_only(array: Array) -> Array:
    """Build a read-only view of an array for user-defined functions.

    A changed array would change the simulation.
    """
    view = array.view()
    view.flags.writeable = False
    return view


def _per_episode(name: str, function: Callable[[Transition], Any], now: Transition) -> Array:
    """Evaluate a user-defined function for all episodes (n,).

    `name` is that of the task's field, and `now` the transition of all episodes. Raises TypeError,
    ValueError.
    """
    given = call_user_function(
        f"Task.{name}",
        function,
        now,
        "give a function of a Transition that returns one number for each episode",
    )
    values = given.astype(float) if isinstance(given, np.ndarray) and given.dtype == bool else given
    return finite_array(f"result of Task.{name}", values, (len(now.time),))
