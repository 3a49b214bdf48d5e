"""Scene files with optimal control problems."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ocp.io.plan_section import SOLVE_ARGUMENTS, read_plan, write_plan
from ocp.io.study_sections import build_studies, read_studies, write_studies
from ocp.problem.problem import Problem
from tenscasadi.io.document import read_document, write_document
from tenscasadi.io.scene_files import read_scene, write_scene
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.reading import Document, NotWritten
from tenscasadi.simulation.declared import Simulation
from tenscasadi.simulation.simulation_files import START, read_simulation
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import FilePath, file_path, instance


def load_problem(path: FilePath) -> Problem:
    """Read a problem from a scene file with a table [plan].

    No content of the file is executed. Other files are opened only if they are included and in the
    same folder.

    Parameters
    ----------
    path : str or os.PathLike
        TOML file, see docs/scene_files.md.

    Returns
    -------
    Problem
        Problem of [plan] for the model of [structure] and [scene]. It starts as [plan] or [start]
        says.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    tenscasadi.SceneFileError
        If the file is not a scene file or has no [plan]. The message has one line: file, line, key,
        value and cure.

    See Also
    --------
    load_solve_arguments : Read the other arguments of `solve`, too.
    save_problem : Write a problem.

    Examples
    --------
    >>> import tempfile
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(model, 0.5, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(1.0, 200.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ocp.load_problem(ocp.save_problem(problem, f"{folder}/prism.toml")).duration
    0.5
    """
    return load_solve_arguments(path)["problem"]  # type: ignore[no-any-return]


def load_solve_arguments(path: FilePath) -> dict[str, Any]:
    """Read the arguments of `solve` from a scene file.

    Parameters
    ----------
    path : str or os.PathLike
        TOML file with a table [plan], see docs/scene_files.md.

    Returns
    -------
    dict
        Arguments of `solve` by name: "problem", and those of "transcription", "solver", "guess",
        "tolerance", "time_limit", "n_starts" and "tracked" that the file has.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    tenscasadi.SceneFileError
        If the file is not a scene file or has no [plan]. The message has one line: file, line, key,
        value and cure.

    See Also
    --------
    load_problem : Read the problem alone.

    Examples
    --------
    >>> import tempfile
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(model, 0.5, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(1.0, 200.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = ocp.save_problem(problem, f"{folder}/prism.toml", transcription=ocp.Variational(6))
    ...     plan = ocp.solve(**ocp.load_solve_arguments(path))
    >>> plan.transcription.intervals
    6
    """
    return read_arguments(read_document(path))


def read_arguments(document: Document) -> dict[str, Any]:
    """Read the arguments of `solve` from a parsed scene file.

    Raises SceneFileError.
    """
    scene = read_scene(document)
    item = document.section("plan")
    if item is None:
        raise document.root.error(
            "it has no [plan]: give one with duration, goals, bounds and costs"
        )
    return read_plan(item, _read_simulation(document, scene))


def load_studies(path: FilePath) -> dict[str, dict[str, Any]]:
    """Read the studies of a plan from a scene file.

    Parameters
    ----------
    path : str or os.PathLike
        TOML file, see docs/scene_files.md.

    Returns
    -------
    dict of str to dict
        Fields of the tables that the file has: "refinement", the arguments of `Plan.refine`;
        "robustness", those of `Plan.robustness`; and "closed_loop", those of `run`. Its
        "controller" is built by ``controller.build(problem, plan)``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    tenscasadi.SceneFileError
        If the file is not a scene file, or one of the tables is wrong.

    See Also
    --------
    save_problem : Write studies.

    Examples
    --------
    >>> import tempfile
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(model, 0.5, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(1.0, 200.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = ocp.save_problem(problem, f"{folder}/prism.toml", studies={"refinement": {"tolerance": 1e-5}})
    ...     ocp.load_studies(path)["refinement"]
    {'tolerance': 1e-05, 'attempts': 5}
    """
    studies = read_studies(read_document(path))
    return {name: dict(vars(own)) for name, own in studies._asdict().items() if own is not None}


def save_problem(
    problem: Problem,
    path: FilePath,
    *,
    studies: Mapping[str, Mapping[str, Any]] | None = None,
    **solve_arguments: Any,
) -> Path:
    """Write a problem to a scene file.

    Numbers read back are equal to the last bit.

    Parameters
    ----------
    problem : Problem
        Problem, which is written with its model.
    path : str or os.PathLike
        TOML file. An existing file is replaced.
    studies : mapping of str to mapping, optional
        Fields of the tables "refinement", "robustness" and "closed_loop", as `load_studies`
        returns them. A controller may be a mapping, such as ``{"kind": "Mpc", "period": 0.05}``.
    **solve_arguments
        Further arguments of `solve`: ``transcription``, ``solver``, ``guess``, ``tolerance``,
        ``time_limit``, ``n_starts``, ``tracked``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError
        If `problem` is not a problem, or a keyword is not an argument of `solve`.
    ValueError
        If a part of the problem cannot be written. These are Python functions, such as those of
        `Constraint`, `Integral` and `AtEnd`, and the user's own goals and schemes.
    OSError
        If the file cannot be written.

    See Also
    --------
    load_problem : Read a problem.
    load_studies : Read studies.

    Examples
    --------
    >>> import tempfile
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(model, 0.5, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(1.0, 200.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = ocp.save_problem(problem, f"{folder}/prism.toml", solver=ocp.Ipopt(max_iterations=50))
    ...     "max_iterations = 50" in path.read_text()
    True
    """
    instance("problem", problem, Problem, "an ocp.Problem")
    target = file_path("path", path)
    for name in solve_arguments:
        if name not in SOLVE_ARGUMENTS:
            raise TypeError(f"save_problem takes no {name!r}: give {', '.join(SOLVE_ARGUMENTS)}")
    asked = build_studies({} if studies is None else studies)
    try:
        tables = {
            **write_scene(problem.scene),
            "plan": write_plan(problem, solve_arguments),
            **write_studies(asked),
        }
    except NotWritten as error:
        raise add_address(ValueError(f"problem cannot be written, {error}")) from None
    return write_document(target, tables)


def describe_problem(problem: Problem) -> str:
    """Format duration, goals, bounds and costs in one line."""
    times = dict.fromkeys(f"{time:g}" for time in (problem.shortest, problem.longest))
    parts = {
        name: [type(value).__name__ for value in getattr(problem, name)]
        for name in ("phases", "goals", "bounds", "costs")
    }
    texts = [f"{name}: {', '.join(kinds)}" for name, kinds in parts.items() if kinds]
    return f"{' to '.join(times)} s, {'; '.join(texts)}"


def _read_simulation(document: Document, scene: Scene) -> Simulation:
    """Read the tables [start] and [simulation].

    Without [simulation], the duration is arbitrary.
    """
    if document.section("simulation") is not None:
        return read_simulation(document, scene)
    first = document.section("start")
    if first is None:
        return Simulation(scene, 1.0)
    start = START.read(first._replace(names=scene.structure.names))
    return Simulation(scene, 1.0, **start.options(scene))
