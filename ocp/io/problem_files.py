"""Problems from scene files, and back to the last bit."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ocp.io.plan_section import WAY, read_plan, write_plan
from ocp.problem.problem import Problem
from tenscasadi.io.document import read_document, write_document
from tenscasadi.io.scene_files import read_scene, write_scene
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.reading import Document, NotWritten
from tenscasadi.simulation.declared import Simulation
from tenscasadi.simulation.simulation_files import START, read_simulation
from tenscasadi.util.validate import file_path, instance


def load_problem(path: str | os.PathLike[str]) -> Problem:
    """Read a problem from a scene file with a table [plan].

    Nothing in the file is run, and no file is opened but those that it includes from its own
    folder.

    Parameters
    ----------
    path : str or os.PathLike
        A file in TOML, as docs/scene_files.md describes it.

    Returns
    -------
    Problem
        The problem of [plan] for the model of [structure] and [scene], from the start of [start]
        unless [plan] has its own.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    tenscasadi.SceneFileError
        If it is no scene file or has no [plan], in one line: file, line, key, value and cure.

    See Also
    --------
    load_arguments : Also how it is solved.
    save_problem : Write one.

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
    return load_arguments(path)["problem"]  # type: ignore[no-any-return]


def load_arguments(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a problem, and how it is solved, from a scene file with a table [plan].

    Parameters
    ----------
    path : str or os.PathLike
        A file in TOML, as docs/scene_files.md describes it.

    Returns
    -------
    dict
        The arguments of `solve` that the file gives, by name: "problem", and where they are there
        "transcription", "solver", "guess", "tolerance", "seconds", "starts" and "tracked".

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    tenscasadi.SceneFileError
        If it is no scene file or has no [plan], in one line: file, line, key, value and cure.

    See Also
    --------
    load_problem : The problem alone.

    Examples
    --------
    >>> import tempfile
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(model, 0.5, goals=[ocp.AtRest()], bounds=[ocp.ForceDensityLimits(1.0, 200.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = ocp.save_problem(problem, f"{folder}/prism.toml", transcription=ocp.Variational(6))
    ...     plan = ocp.solve(**ocp.load_arguments(path))
    >>> plan.transcription.intervals
    6
    """
    return read_arguments(read_document(path))


def read_arguments(document: Document) -> dict[str, Any]:
    """Read the arguments of `solve` from a document. Raises SceneFileError."""
    scene = read_scene(document)
    item = document.section("plan")
    if item is None:
        raise document.root.error(
            "it has no [plan]: give one with duration, goals, bounds and costs"
        )
    return read_plan(item, _simulation(document, scene))


def save_problem(problem: Problem, path: str | os.PathLike[str], **way: Any) -> Path:
    """Write a problem to a scene file, from which it comes back to the last bit.

    Parameters
    ----------
    problem : Problem
        What is written, with its model.
    path : str or os.PathLike
        The file in TOML; one that is there is replaced.
    **way
        How it is solved, as `solve` takes it: ``transcription``, ``solver``, ``guess``,
        ``tolerance``, ``seconds``, ``starts``, ``tracked``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError
        If `problem` is none, or an argument is none of `solve`.
    ValueError
        If a part of it cannot be written, by its name: `Constraint`, `Integral` and `AtEnd`, whose
        expressions are functions in Python, other functions, such as who watches a solver, goals
        and schemes of your own.
    OSError
        If the file cannot be written.

    See Also
    --------
    load_problem : Read it.

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
    for name in way:
        if name not in WAY:
            raise TypeError(f"save_problem takes no {name!r}: give {', '.join(WAY)}")
    try:
        tables = {**write_scene(problem.model.scene), "plan": write_plan(problem, way)}
    except NotWritten as error:
        raise ValueError(f"problem cannot be written, {error}") from None
    return write_document(target, tables)


def describe_problem(problem: Problem) -> str:
    """Format duration, goals, bounds and costs in a line."""
    times = dict.fromkeys(f"{time:g}" for time in (problem.shortest, problem.longest))
    parts = {
        name: [type(value).__name__ for value in getattr(problem, name)]
        for name in ("phases", "goals", "bounds", "costs")
    }
    texts = [f"{name}: {', '.join(kinds)}" for name, kinds in parts.items() if kinds]
    return f"{' to '.join(times)} s, {'; '.join(texts)}"


def _simulation(document: Document, scene: Scene) -> Simulation:
    """Return what [start] and [simulation] tell; without the latter of no certain length."""
    if document.section("simulation") is not None:
        return read_simulation(document, scene)
    first = document.section("start")
    if first is None:
        return Simulation(scene, 1.0)
    start = START.read(first._replace(names=scene.structure.names))
    return Simulation(scene, 1.0, **start.options(scene))
