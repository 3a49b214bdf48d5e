"""Files for MuJoCo, run by MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tenscasadi as tc


def mujoco_ends(
    path: Path, t_end: float, velocities: Any = None, step: float | None = None, control: Any = None
) -> np.ndarray:
    """Nodes (n, 3), named n0, n1 …, at the end of MuJoCo's run of a file."""
    mujoco = pytest.importorskip("mujoco")
    world = mujoco.MjModel.from_xml_path(str(path))
    if step is not None:
        world.opt.timestep = step
    data = mujoco.MjData(world)
    if world.nkey:
        mujoco.mj_resetDataKeyframe(world, data, 0)
    if control is not None:
        data.ctrl[:] = control
    mujoco.mj_step(world, data, round(t_end / world.opt.timestep))
    mujoco.mj_kinematics(world, data)
    count = sum(world.site(k).name.startswith("n") for k in range(world.nsite))
    return np.array([data.site(f"n{node}").xpos for node in range(count)])


def differences(
    scene: tc.Scene,
    path: Path,
    velocities: Any = None,
    joints: Any = "ball",
    t_end: float = 0.25,
    steps: Any = (1e-3, 5e-4),
) -> list[float]:
    """How far, m, MuJoCo's nodes are from ours at the end, for each of its steps."""
    model = tc.Model(scene)
    start = model.state(scene.modelled.nodes, velocities)
    ours = tc.simulate(
        model,
        t_end,
        2.5e-4,
        state=start,
        correction=tc.Projection(),
        save_every=100,
        compiled=False,
    )
    assert ours.success
    assert abs(ours.nodes - ours.nodes[0]).max() > 1e-3
    found = []
    for step in steps:
        tc.export_mjcf(scene, path, velocities, joints, step)
        found.append(float(abs(mujoco_ends(path, t_end) - ours.nodes[-1]).max()))
    return found
