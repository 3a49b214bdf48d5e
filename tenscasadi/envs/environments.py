"""Gymnasium environments with one or many episodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.envs.episodes import FARTHEST, Episodes
from tenscasadi.envs.rendering import RENDERERS, Renderer, build_renderer, observe_frame
from tenscasadi.envs.task import Task
from tenscasadi.util.validate import finite_array, instance, real_array, whole_number

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError("tenscasadi.envs needs gymnasium: pip install 'tenscasadi[gym]'") from error


class TensegrityEnv(gymnasium.Env[Any, Any]):
    """Control task as a gymnasium environment.

    Parameters
    ----------
    task : Task
        The task.
    render_mode : {"rgb_array", "human"}, optional
        Display: `render` returns pictures (400, 480, 3), or each period is shown in the browser in
        real time, which requires ``pip install 'tenscasadi[view]'``. Default: none.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong.

    See Also
    --------
    TensegrityVectorEnv : Many episodes in parallel.

    Notes
    -----
    Actions are (α,) from −1 to 1, observations (k,) in single precision. `info` states whether the
    episode ``diverged``.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.envs import Task, TensegrityEnv
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> env = TensegrityEnv(Task(model, lambda now: -((now.nodes[:, 2, 0] - 0.3) ** 2), lower=0.0, upper=20.0))
    >>> seen, info = env.reset(seed=0)
    >>> seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> seen.shape, terminated, truncated
    ((24,), False, False)
    """

    metadata = {"render_modes": [*RENDERERS], "render_fps": 20}  # noqa: RUF012  as gymnasium declares it

    def __init__(self, task: Task, render_mode: str | None = None) -> None:
        instance("task", task, Task, "a tenscasadi.envs.Task")
        self.task, self.render_mode = task, render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(1 / task.period))}
        self._renderer: Renderer | None = (
            None if render_mode is None else build_renderer(render_mode, task.model, task.period)
        )
        self._episodes = Episodes(task, 1)
        self.observation_space, self.action_space = _spaces(self._episodes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            Seed of all later draws.
        options : dict, optional
            Not used.

        Returns
        -------
        observation : ndarray, shape (k,)
            The observation.
        info : dict
            Whether the episode ``diverged``.
        """
        super().reset(seed=seed)
        self._episodes.reset(np.array([0]), self.np_random)
        self._show()
        return self._episodes.observe()[0], {"diverged": False}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Simulate one control period.

        Parameters
        ----------
        action : array_like, shape (α,)
            The action, clipped to −1 … 1.

        Returns
        -------
        observation : ndarray, shape (k,)
            The observation.
        reward : float
            The reward.
        terminated, truncated : bool
            Whether the episode has ended, by the task or by its duration.
        info : dict
            Whether it ``diverged``.
        """
        now, lost = self._episodes.step(_clip_action("action", action, (self.task.model.nu,))[None])
        reward, over = (
            float(self._episodes.rewards(now, lost)[0]),
            bool(self._episodes.find_ended(now, lost)[0]),
        )
        late = bool(self._episodes.decided[0] >= self.task.decisions)
        self._show()
        return self._episodes.observe()[0], reward, over, late, {"diverged": bool(lost[0])}

    def render(self) -> Any:
        """Draw the present state.

        Returns
        -------
        ndarray of uint8, shape (400, 480, 3), or None
            The picture under ``render_mode="rgb_array"``; None otherwise.
        """
        if self._renderer is None:
            return None
        episodes = self._episodes
        frame = observe_frame(
            self.task.model,
            episodes.states[0],
            episodes.control[0],
            episodes.parameters[0],
            float(episodes.decided[0] * self.task.period),
        )
        return self._renderer.draw(frame)

    def close(self) -> None:
        """Close the display."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _show(self) -> None:
        """Show the present state if the render mode is "human"."""
        if self.render_mode == "human":
            self.render()


class TensegrityVectorEnv(VectorEnv[Any, Any, Any]):
    """Vectorized gymnasium environment for a control task.

    Parameters
    ----------
    task : Task
        The task.
    num_envs : int
        Number of episodes, n.
    threads : int
        Number of threads.

    See Also
    --------
    TensegrityEnv : One episode at a time.

    Notes
    -----
    An episode that has ended restarts in the next step, which ignores its action
    (`AutoresetMode.NEXT_STEP`). Episodes run in the lanes of each instruction.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.envs import Task, TensegrityVectorEnv
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> task = Task(model, lambda now: -((now.nodes[:, 2, 0] - 0.3) ** 2), lower=0.0, upper=20.0, start=0.01)
    >>> envs = TensegrityVectorEnv(task, 16)
    >>> seen, info = envs.reset(seed=0)
    >>> seen, rewards, terminated, truncated, info = envs.step(envs.action_space.sample())
    >>> seen.shape, rewards.shape
    ((16, 24), (16,))
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012  as gymnasium declares it

    def __init__(self, task: Task, num_envs: int, threads: int = 1) -> None:
        instance("task", task, Task, "a tenscasadi.envs.Task")
        self.task, self.num_envs = task, whole_number("num_envs", num_envs, 1, 10**6)
        self._episodes = Episodes(task, num_envs, whole_number("threads", threads, 1, 1024))
        self.single_observation_space, self.single_action_space = _spaces(self._episodes)
        self.observation_space, self.action_space = (
            batch_space(space, num_envs)
            for space in (self.single_observation_space, self.single_action_space)
        )
        self._over = np.ones(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or some of them.

        Parameters
        ----------
        seed : int, optional
            Seed of all later draws.
        options : dict, optional
            ``{"reset_mask": ...}`` with a Boolean array (n,) of the episodes to start; the others
            continue.

        Returns
        -------
        observations : ndarray, shape (n, k)
            The observations.
        info : dict
            Which episodes ``diverged``.
        """
        begun = self._read_reset_mask(options)
        super().reset(seed=seed)
        self._episodes.reset(np.flatnonzero(begun), self.np_random)
        self._over = self._over & ~begun
        return self._episodes.observe(), {"diverged": np.zeros(self.num_envs, dtype=bool)}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Simulate one control period; restart episodes that have ended.

        Parameters
        ----------
        actions : array_like, shape (n, α)
            The actions, clipped to −1 … 1.

        Returns
        -------
        observations : ndarray, shape (n, k)
            The observations.
        rewards : ndarray, shape (n,)
            The rewards.
        terminated, truncated : ndarray of bool, shape (n,)
            Which episodes have ended, by the task or by their duration.
        info : dict
            Which of them ``diverged``.
        """
        now, lost = self._episodes.step(
            _clip_action("actions", actions, (self.num_envs, self.task.model.nu))
        )
        begun = self._over
        rewards = np.where(begun, 0.0, self._episodes.rewards(now, lost))
        over = self._episodes.find_ended(now, lost) & ~begun
        late = (self._episodes.decided >= self.task.decisions) & ~begun
        if begun.any():
            self._episodes.reset(np.flatnonzero(begun), self.np_random)
        self._over = over | late
        return self._episodes.observe(), rewards, over, late, {"diverged": lost & ~begun}

    def _read_reset_mask(self, options: dict[str, Any] | None) -> Any:
        """Read the mask (n,) of episodes to start.

        It is one of the options of `reset`. Without a mask all are started. Raises ValueError.
        """
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, dtype=bool)
        mask = np.asarray(options["reset_mask"])
        if mask.dtype != bool or mask.shape != (self.num_envs,):
            raise ValueError(
                f"options['reset_mask'] is {mask.dtype} of shape {mask.shape}: give bool of shape ({self.num_envs},)"
            )
        return mask


def _spaces(episodes: Episodes) -> tuple[Any, Any]:
    """Build the observation and action spaces of one episode."""
    size, count = episodes.observe().shape[1], episodes.task.model.nu
    return gymnasium.spaces.Box(-FARTHEST, FARTHEST, (size,), np.float32), gymnasium.spaces.Box(
        -1.0, 1.0, (count,), np.float32
    )


def _clip_action(field: str, given: Any, shape: tuple[int, ...]) -> Any:
    """Clip actions of a shape to −1 … 1.

    `field` is the name of the argument `given`, for messages. Raises TypeError, ValueError.
    """
    wanted = f"{shape} finite numbers from -1 to 1"
    values = real_array(field, given, wanted)
    if values.shape not in (shape, (1, *shape), shape[1:]) or values.size != np.prod(shape):
        raise ValueError(f"{field} has shape {values.shape}: give {wanted}")
    return np.clip(finite_array(field, values.reshape(shape), shape), -1.0, 1.0)
