"""Export of structures to glTF 3-D files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.meshes import (
    Mesh,
    Poses,
    build_ball,
    build_cone,
    build_cylinder,
    place_balls,
    stretch_cylinders,
)
from tenscasadi.drawing.scenery import cut_ground, find_view
from tenscasadi.drawing.shapes import PARTS, MotionShapes
from tenscasadi.drawing.style import STYLE, Bytes, Rgb, linearize_colors
from tenscasadi.drawing.view_content import Motion
from tenscasadi.util.validate import Array, FilePath, file_path, finite_array
from tenscasadi.util.whole_file import whole_file

_MESHES = {"member": build_cylinder(12), "ball": build_ball(8, 12), "cone": build_cone(16)}
# glTF has y upward
_UPWARD = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def export_gltf(data: Any, path: FilePath, *, time: float | None = None) -> Path:
    """Write a structure with its grounds as a 3-D picture in glTF.

    Slides, browsers and Blender read such files. Bars, strings, nodes and supports are objects with
    their names, and strings have the color of their tension. Lengths are in m. It requires
    ``pip install 'tenscasadi[exchange]'``.

    Parameters
    ----------
    data : Structure, Scene, Model, Trajectory or ocp.Plan
        A structure, or a motion at one of its times.
    path : str or PathLike
        File to write; its name ends in .glb.
    time : float, optional
        Time of the motion [s]. Default: its end.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong.
    ImportError
        If trimesh is not installed.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.export_gltf(tc.shapes.prism(prestress=50.0), "prism.glb").name
    'prism.glb'
    """
    target = file_path("path", path)
    if target.suffix.lower() != ".glb":
        raise ValueError(f"path is {os.fspath(path)!r}: give a file name that ends in .glb")
    content = describe_content(data, "data")
    motion = content.motions[0]
    instant = motion.end if time is None else float(finite_array("time", time, ()))
    if not motion.start <= instant <= motion.end:
        raise ValueError(
            f"time is {instant:g} s: give a time from {motion.start:g} to {motion.end:g} s"
        )
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(
            "export_gltf needs trimesh: pip install 'tenscasadi[exchange]'"
        ) from error
    scene = trimesh.Scene()
    frame = motion.frame_at(instant)
    scale = None if frame.tension is None else ColorScale.of("tension", frame.tension)
    shapes = MotionShapes(content).build(frame, scale, ())
    for part, shape in zip(PARTS, shapes, strict=False):  # arrows are left out
        place = stretch_cylinders if shape.form == "member" else place_balls
        names, poses = (
            _list_names(motion, part, len(shape.points)),
            place(shape.points, shape.radius),
        )
        _add_copies(scene, _MESHES[shape.form], names, poses, shape.colors)
    faces = [shape for shape in shapes if shape.form == "face"]
    for k, shape in enumerate(faces):
        indices = np.arange(3 * len(shape.points)).reshape(-1, 3)
        mesh = _color(trimesh, Mesh(shape.points.reshape(-1, 3), indices), STYLE.body)
        scene.add_geometry(mesh, node_name=f"body {k}", transform=_UPWARD)
    for k, ground in enumerate(content.grounds):
        patch = cut_ground(ground, *find_view(content, STYLE.ground_margin))
        if patch is not None:
            mesh = _color(trimesh, Mesh(patch.vertices, patch.faces), STYLE.ground)
            scene.add_geometry(mesh, node_name=f"ground {k}", transform=_UPWARD)
    with whole_file(target) as file:
        file.write(scene.export(file_type="glb"))
    return target


def _list_names(motion: Motion, part: str, count: int) -> list[str]:
    """Build unique object names for nodes, bars, strings or supports.

    `part` is "nodes", "bars", "strings" or "supports", and `count` the number of objects, over all
    copies of the structure.
    """
    if part == "supports":
        return [f"support {k}" for k in range(count)]
    own, copies = motion.names[part], motion.copies
    kind = part[:-1]
    found = []
    for k in range(count):
        copy, item = divmod(k, len(own))
        name = own[item] if own[item].startswith(f"{kind} ") else f"{kind} {own[item]}"
        found.append(f"{name} of motion {copy}" if copies > 1 else name)
    return found


def _add_copies(scene: Any, mesh: Mesh, names: list[str], poses: Poses, colors: Bytes) -> None:
    """Add copies of a mesh to a glTF scene.

    Each copy has one of the `names`, one of the `poses`, and an RGB color. Copies of one color
    share their geometry.
    """
    import trimesh

    for name, transform, row in zip(names, _build_transforms(poses), colors.tolist(), strict=True):
        color = (row[0], row[1], row[2])
        own = f"{names[0].split()[0]} #{bytes(color).hex()}"
        if own not in scene.geometry:
            scene.geometry[own] = _color(trimesh, mesh, color)
        scene.graph.update(name, geometry=own, matrix=_UPWARD @ transform)


def _build_transforms(poses: Poses) -> Array:
    """Build transformation matrices (m, 4, 4) from poses.

    They scale, rotate and translate copies.
    """
    w, x, y, z = (poses.quaternions / np.linalg.norm(poses.quaternions, axis=1)[:, None]).T
    rotations = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    found = np.zeros((len(w), 4, 4))
    found[:, :3, :3] = rotations * poses.scales[:, None, :]
    found[:, :3, 3], found[:, 3, 3] = poses.positions, 1.0
    return found


def _color(trimesh: Any, mesh: Mesh, color: Rgb) -> Any:
    """Build a mesh with a material of one color.

    `trimesh` is the imported package.
    """
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[*linearize_colors(color).tolist(), 255],
        metallicFactor=0.0,
        roughnessFactor=0.8,
        doubleSided=True,
    )
    visual = trimesh.visual.TextureVisuals(material=material)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
