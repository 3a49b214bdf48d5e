"""The peers' cases in tests/data as scenes: inputs from their files, nothing tuned."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.mechanism import Coordinates
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure

DATA = Path(__file__).parents[1] / "data"
MOTES = sorted(path.stem for path in (DATA / "motes").glob("*.npz") if "published" not in path.stem)
CERTIFIED = sorted(path.stem for path in (DATA / "certified").glob("*.npz"))


class Case:
    """A peer's scene, its initial state on physical nodes, and its recorded results (`data`, `info`)."""

    def __init__(
        self, scene: Scene, velocities: Any, columns: Any, data: Any, info: dict[str, Any]
    ) -> None:
        self.scene, self.data, self.info = scene, data, info
        self.velocities = np.asarray(velocities)  # (n, 3) on physical nodes
        self.columns = columns  # the peer's column of each physical node

    @property
    def nodes(self) -> Any:
        """Recorded trajectory of physical nodes (T, n, 3)."""
        return (
            self.data["q"][:, self.columns]
            if "q" in self.data
            else self.data["N"].transpose(0, 2, 1)[:, self.columns]
        )


def first_columns(structure: Structure) -> Any:
    """The first class-one column of each physical node."""
    return np.unique(structure.class_one().physical, return_index=True)[1]


def motes(name: str) -> Case:
    """A case computed by the paper's authors' own program."""
    data = dict(np.load(DATA / "motes" / f"{name}.npz"))
    info = json.loads((DATA / "motes" / f"{name}.json").read_text())
    mass = np.zeros(data["N0"].shape[1])
    if data["m_string_node"].size:
        mass[-data["m_string_node"].size :] = data["m_string_node"]
    structure = Structure.from_matrices(
        data["N0"], data["C_b"], data["C_s"], data["P"], data["D"], node_mass=mass, bar_mass=data["m_bar"], stiffness=data["k"],
        damping=data["c"], rest_length=data["s0"],
    )  # fmt: skip
    loads = np.zeros((len(structure.nodes), 3))
    np.add.at(loads, structure.class_one().physical, data["W"].T)
    first = first_columns(structure)
    return Case(
        Scene(structure, forces=NodalForce(loads) if loads.any() else None),
        data["Nd0"].T[first],
        first,
        data,
        info,
    )


def certified(name: str) -> Case:
    """A case solved in extended precision with located events."""
    data = dict(np.load(DATA / "certified" / f"{name}.npz"))
    info = json.loads((DATA / "certified" / f"{name}.json").read_text())
    spec = info["spec"]
    N = np.array(spec["nodes"], dtype=float).T

    def connectivity(pairs: list[list[int]]) -> Any:
        C = np.zeros((len(pairs), N.shape[1]))
        for row, (a, b) in zip(C, pairs, strict=True):
            row[a], row[b] = -1, 1
        return C

    structure = Structure.from_matrices(
        N, connectivity(spec.get("bars", [])), connectivity(spec.get("strings", [])), spec.get("P"), spec.get("D"),
        node_mass=spec.get("point_mass", 0.0), bar_mass=spec.get("bar_mass", 1.0), bar_radius=spec.get("bar_radius", 0.0),
        stiffness=spec.get("k", 100.0), damping=spec.get("c", 0.0), rest_length=spec.get("rho") or None,
    )  # fmt: skip
    first = first_columns(structure)
    contact = spec.get("contact")
    scene = Scene(
        structure,
        gravity=Gravity(spec["gravity"]) if spec.get("gravity") else None,
        ground=Ground(contact["kg"], contact["cg"]) if contact else None,
    )
    velocities = np.array(spec.get("velocities", np.zeros(N.T.shape)), dtype=float)
    return Case(scene, velocities[first], first, data, info)


def solve_certified(
    name: str, scheme: Scheme, coordinates: Any = "reduced", every: int = 1, **options: Any
) -> tuple[float, Trajectory]:
    """The largest error of any node at any certified time, m, and the run: `every` steps between two of these times."""
    case = certified(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(case.scene, coordinates)
    times = case.data["t"]
    start = model.state(case.nodes[0], case.velocities)
    run = simulate(
        model,
        times[-1],
        times[1] / every,
        scheme,
        start,
        save_every=every,
        **{"compiled": False} | options,
    )
    assert run.success, run.message
    assert np.array_equal(run.time, times) or np.allclose(run.time, times, rtol=0, atol=1e-12)
    return float(abs(run.nodes - case.nodes).max()), run


def stedy(name: str) -> Case:
    """A case computed by STEDY: shared nodes, supports per axis, forces W_gravity + W_sin_t sin(t)."""
    data = dict(np.load(DATA / "stedy" / f"{name}.npz"))
    info = json.loads((DATA / "stedy" / f"{name}.json").read_text())
    fixed = data["fixed"].T.astype(bool)
    members = {
        key: [tuple(np.array(pair) - 1) for pair in info[f"{key}_1based"]]
        for key in ("bars", "strings")
    }
    structure = Structure(
        data["N0"].T, **members, bar_mass=data["m_bar"], stiffness=data["k"], damping=data["c"], rest_length=data["s0"],
        pinned={node: "".join(axis for axis, held in zip("xyz", row, strict=True) if held) for node, row in enumerate(fixed) if row.any()},
    )  # fmt: skip
    assert not data["W_sin_t"].any()
    forces = NodalForce(data["W_gravity"].T) if data["W_gravity"].any() else None
    return Case(Scene(structure, forces=forces), data["Nd0"].T, np.arange(len(fixed)), data, info)


def trajectory_error(
    case: Case, times: np.ndarray, step: float, coordinates: Coordinates = "reduced"
) -> np.ndarray:
    """Return the largest distance of any coordinate from the recorded nodes at each recorded time (T,)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(case.scene, coordinates)
    nodes = case.nodes[: len(times)]
    per_row = int(np.ceil((times[1] - times[0]) / step - 1e-9))
    step = times[-1] / (len(times) - 1) / per_row
    trajectory = simulate(
        model,
        times[-1],
        step,
        state=model.state(nodes[0], case.velocities),
        correction=Projection(),
        save_every=per_row,
    )
    assert trajectory.success, trajectory.message
    assert trajectory.bar_length_error.max() < 1e-14
    assert trajectory.joint_error.max() < 1e-14
    return abs(trajectory.nodes - nodes).max(axis=(1, 2))
