"""Export of trajectories to ParaView, as .vtu frames and a .pvd file."""

from __future__ import annotations

import html
import os
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.drawing.hulls import find_hulls
from tenscasadi.dynamics.model import Model
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.class_one import distances
from tenscasadi.util.validate import Array, FilePath, Indices, file_path, instance, whole_number
from tenscasadi.util.whole_file import whole_file


def export_vtk(
    trajectory: Trajectory,
    path: FilePath,
    *,
    model: Model | None = None,
    every: int = 1,
) -> Path:
    """Write a trajectory for ParaView.

    Open the .pvd file in ParaView. It lists the frames, one .vtu file for each saved time, in a
    folder of the same name beside it. A frame contains bars and strings as lines, and faces of rigid
    bodies as triangles. Their fields are ``kind`` (0 for bars, 1 for strings, 2 for bodies),
    ``number``, ``length`` [m], ``force_density`` [N/m] and ``tension`` [N], negative in compression.
    Bodies have the first two. Nodes have the fields ``number``, ``velocity`` [m/s] and ``pinned``.
    It requires ``pip install 'tenscasadi[exchange]'``.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory.
    path : str or PathLike
        File to write; its name ends in .pvd.
    model : Model, optional
        The simulated model, from which bar forces are computed. Default: they are NaN.
    every : int
        Write every `every`-th saved time.

    Returns
    -------
    Path
        The .pvd file.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the model is not that of the trajectory.
    ImportError
        If meshio is not installed.
    OSError
        A file cannot be written.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> run = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism())), 0.1, 0.01, compiled=False)
    >>> tc.export_vtk(run, "run.pvd").name
    'run.pvd'
    """
    instance("trajectory", trajectory, Trajectory, "a Trajectory, such as plan.trajectory")
    target = file_path("path", path)
    if target.suffix.lower() != ".pvd":
        raise ValueError(f"path is {os.fspath(path)!r}: give a file name that ends in .pvd")
    rows = range(0, len(trajectory.time), whole_number("every", every, 1))
    pushes = _bar_force_density(trajectory, model)
    try:
        import meshio
    except ImportError as error:
        raise ImportError("export_vtk needs meshio: pip install 'tenscasadi[exchange]'") from error
    folder = target.with_suffix("")
    folder.mkdir(exist_ok=True)
    hulls = find_hulls(None if trajectory.scene is None else trajectory.scene.structure)
    names = [
        f"{folder.name}/{target.stem}_{k:0{len(str(len(rows)))}d}.vtu" for k in range(len(rows))
    ]
    for name, row in zip(names, rows, strict=True):
        meshio.vtu.write(target.parent / name, _frame(meshio, trajectory, row, pushes[row], hulls))
    frames = [
        f'    <DataSet timestep="{float(trajectory.time[row])!r}" file="{html.escape(name)}"/>'
        for name, row in zip(names, rows, strict=True)
    ]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="Collection" version="0.1">',
        "  <Collection>",
        *frames,
        "  </Collection>",
        "</VTKFile>",
        "",
    ]
    with whole_file(target) as file:
        file.write("\n".join(lines).encode())
    return target


def _bar_force_density(run: Trajectory, model: Model | None) -> Array:
    """Compute the force densities of bars (T, β) [N/m].

    They are those along a run. They are negative in compression, where λ is positive (Eq. 87), and
    NaN without a model.
    """
    if model is None:
        return np.full((len(run.time), len(run.bars)), np.nan)
    instance("model", model, Model, "a Model or None")
    sizes = (model.nx, model.nu, len(model.parameters.nominal))
    if sizes != (
        run.states.shape[1],
        run.control.shape[1],
        len(run.parameters),
    ) or not np.array_equal(model.structure.bars, run.bars):
        raise ValueError(
            "model is not that of the trajectory: its states, controls, parameters or bars are others"
        )
    held = np.hstack([run.control, np.tile(run.parameters, (len(run.time), 1))])
    lam = model.with_stacked_input(model.multiplier_function).map(len(run.time))(
        run.states.T, held.T if held.size else np.zeros((0, len(run.time)))
    )[0]
    return np.asarray(-lam.full().T.reshape(len(run.time), -1))


def _frame(
    meshio: Any, run: Trajectory, row: int, bar_force_density: Array, hulls: list[Indices]
) -> Any:
    """Build the mesh of one saved time for ParaView.

    It is that of a run. `row` is the index of the time, and `bar_force_density` (T, β) is in N/m.
    `hulls` are the triangles (·, 3) of each rigid body, as node indices.
    """
    nodes, pinned = run.nodes[row], np.zeros(run.nodes.shape[1])
    pinned[run.pinned] = 1
    lengths = [distances(nodes, pairs) for pairs in (run.bars, run.strings)]
    body = np.repeat(np.arange(float(len(hulls))), [len(hull) for hull in hulls])
    faces = np.concatenate([np.zeros((0, 3), dtype=np.intp), *hulls])
    none = np.full(len(faces), np.nan)
    cells = ("line", run.bars), ("line", run.strings), ("triangle", faces)
    values = {
        "kind": [np.full(len(rows), float(kind)) for kind, (_, rows) in enumerate(cells)],
        "number": [np.arange(float(len(run.bars))), np.arange(float(len(run.strings))), body],
        "length": [*lengths, none],
        "force_density": [bar_force_density, run.force_density[row], none],
        "tension": [bar_force_density * lengths[0], run.tension[row], none],
    }
    present = [k for k, (_, rows) in enumerate(cells) if len(rows)]
    return meshio.Mesh(
        np.array(nodes),
        [(cells[k][0], np.array(cells[k][1])) for k in present],
        point_data={
            "number": np.arange(float(len(nodes))),
            "velocity": np.array(run.velocities[row]),
            "pinned": pinned,
        },
        cell_data={
            name: [np.array(parts[k]) for k in present] for name, parts in values.items() if present
        },
    )
