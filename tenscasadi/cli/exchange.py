"""Commands `export` and `import` for files of other programs."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from tenscasadi.cli.report import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import FILE, find_source
from tenscasadi.exchange.gltf import export_gltf
from tenscasadi.exchange.matlab.save import save_mat
from tenscasadi.exchange.mjcf import export_mjcf
from tenscasadi.exchange.ntrt.save import save_ntrt
from tenscasadi.exchange.readers import READERS
from tenscasadi.exchange.vtk import export_vtk
from tenscasadi.io.document import ENDINGS, SECTIONS
from tenscasadi.io.scene_files import save_scene
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.trajectory import Trajectory

_OWN = dict.fromkeys(ENDINGS, save_scene)
_SCENES: dict[str, Callable[..., object]] = {
    ".glb": export_gltf,
    ".xml": export_mjcf,
    ".mat": lambda scene, path: save_mat(scene.structure, path),
    **dict.fromkeys((".yaml", ".yml"), lambda scene, path: save_ntrt(scene.structure, path)),
    **_OWN,
}
_STRUCTURE_ALONE = (".mat", ".yaml", ".yml")
_MOTIONS: dict[str, Callable[..., object]] = {
    ".glb": export_gltf,
    ".csv": lambda motion, path: motion.to_csv(path),
    ".mat": lambda motion, path: save_mat(_find_trajectory(motion), path),
    ".pvd": lambda motion, path: export_vtk(
        _find_trajectory(motion), path, model=getattr(motion, "model", None)
    ),  # a plan's, for forces of bars
}


def export_file(source: Annotated[str, FILE], out: Annotated[Path, FILE]) -> int:
    """Export a scene, trajectory or plan to other programs.

    Scenes: .xml (MuJoCo), .mat (MATLAB: MOTES), .yaml (NTRT, in m), .glb (a 3-D picture), .toml or
    .json (a scene file without formulas). Trajectories and plans (.npz): .csv, .mat (MATLAB), .pvd
    (ParaView), .glb.

    Parameters
    ----------
    source : str
        Template, scene file (.toml, .json), trajectory or plan (.npz).
    out : Path
        File to write; its ending selects the format.
    """
    if source.endswith(".npz"):
        write = _find_by_ending(_MOTIONS, out, "motions and plans")
        check_file("OUT", out)
        motion = load_result(source)
        if isinstance(motion, Rollouts):
            raise ValueError(f"{source} holds rollouts: give a trajectory or a plan")
        write(motion, out)
        print(f"wrote {out}")
        return 0
    write = _find_by_ending(_SCENES, out, "scenes")
    check_file("OUT", out)
    found = find_source(source)
    if out.exists() and out.samefile(found.path):
        raise ValueError(f"OUT is {out}, the file that is read: give another")
    write(found.scene(), out)
    print(f"wrote {out}")
    alone = out.suffix.lower() in _STRUCTURE_ALONE
    written = {"structure"} if alone else {"structure", "scene"}
    if left := [f"[{name}]" for name in SECTIONS if name not in written and found.has(name)]:
        print(f"tenscasadi: left out: {', '.join(left)}", file=sys.stderr)
    return 0


def import_file(
    source: Annotated[str, FILE],
    out: Annotated[Path, FILE],
    length_unit: float = 1.0,
    ball_joints: bool = True,
    lenient: bool = False,
) -> int:
    """Import a file of another program as a scene file.

    MuJoCo: .xml; MATLAB: .mat of MOTES or TsgFEM; NTRT: .yaml. Parts without a counterpart in a scene
    file are errors; --lenient leaves them out and lists them.

    Parameters
    ----------
    source : str
        File of another program; its ending selects the program.
    out : Path
        Scene file to write (.toml, .json).
    length_unit : float
        NTRT: its unit of length, m (default: 1).
    ball_joints : bool
        NTRT: rods that share a node turn freely there (default), or form one body.
    lenient : bool
        Leave out parts that a scene cannot have, and list them.
    """
    read = _find_by_ending(READERS, Path(source), "scenes")
    _find_by_ending(_OWN, out, "scene files")
    check_file("OUT", out)
    options = {"length_unit": length_unit, "ball_joints": ball_joints, "strict": not lenient}
    save_scene(read(source, **options), out)
    print(f"wrote {out}")
    return 0


def _find_trajectory(motion: Any) -> Trajectory:
    return motion if isinstance(motion, Trajectory) else motion.trajectory


def _find_by_ending(known: dict[str, Any], path: Path, kind: str) -> Any:
    if path.suffix.lower() not in known:
        cure = f"give one of {', '.join(sorted(known))}"
        raise ValueError(f"{path} does not end as the files of {kind} do: {cure}")
    return known[path.suffix.lower()]
