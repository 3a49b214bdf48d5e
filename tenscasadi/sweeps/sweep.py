"""Evaluation of a function for many independent cases."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from typing import Any

from tqdm import tqdm

from tenscasadi.sweeps.case_files import CaseFiles, CaseOutcome
from tenscasadi.sweeps.sweep_table import Sweep
from tenscasadi.sweeps.workers import run_in_processes, run_on_executor
from tenscasadi.util.processes import on_interrupt
from tenscasadi.util.validate import FilePath, as_tuple, file_path, flag, format_value, instance

_MISSING = CaseOutcome({}, "", float("nan"))


def sweep(
    function: Callable[[Any], Any],
    cases: Iterable[Any],
    executor: Executor | None = None,
    folder: FilePath | None = None,
    progress: bool = False,
) -> Sweep:
    """Evaluate a function for many independent cases.

    Cases are, for example, structures, plans or seeds.

    Parameters
    ----------
    function : callable
        Function of one case. It returns a dict of numbers, text and arrays of these, or one of
        them, which is then named ``result``.
    cases : iterable
        Cases: dicts by text, whose values are the columns of the table, or any other value. With a
        `folder`, cases hold None, numbers, text, NumPy arrays, lists, tuples and dicts of these,
        structures, scenes, models, and options that are dataclasses, such as schemes.
    executor : concurrent.futures.Executor, optional
        Executor of the jobs. Default: processes of this machine, one for each core and each with
        one thread. Dask's ``client.get_executor()`` computes on a cluster.
    folder : str or PathLike, optional
        Folder of results. Each case is saved as soon as it finishes. Saved cases are not
        recomputed.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Sweep
        Table of cases and results. A case that raises, or whose worker dies, is recorded with its
        traceback, and the others go on. Ctrl-C ends the sweep early and keeps the finished cases.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, a folder of results cannot identify a case, the folder is that of
        another script's function of the same name, or other processes cannot import the function.
    RuntimeError
        Worker processes cannot begin, as in a script without ``if __name__ == "__main__":``.
    OSError
        The folder cannot be made or written.

    See Also
    --------
    Sweep : The table.

    Notes
    -----
    A case is identified by its content, and by the name and content of the function: the arguments
    of a `functools.partial`, the attributes of its object, and numbers, text, arrays, structures,
    scenes and models in its closure and defaults. No code in a file is run (no pickle).
    Failed cases are computed again in the next sweep of the folder. If the text of the function has
    changed, the message gives the number of older results. Other functions that it calls are not
    compared: take a new folder when they change.

    Processes are spawned, so that a script needs ``if __name__ == "__main__":``. They share compiled
    code, also with machines that share a home folder (``TENSCASADI_CACHE`` names another one).
    Threads share one CasADi, which computes one case after the other: prefer processes.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> import tenscasadi as tc
    >>> def swing(case):
    ...     pendulum = tc.Scene(tc.shapes.pendulum(length=case["length"]), gravity=tc.Gravity())
    ...     return {"speed": tc.simulate(tc.Model(pendulum), 0.1, 0.01, compiled=False).velocities[-1, 1, 0]}
    >>> with ThreadPoolExecutor(1) as executor:
    ...     table = tc.sweep(swing, [{"length": 1.0}, {"length": 2.0}, {"length": -1.0}], executor)
    >>> table
    Sweep(3 cases: 3 computed, 1 failed)
    >>> table["length"].tolist(), table.success.tolist()
    ([1.0, 2.0, -1.0], [True, True, False])
    """
    given = _check(function, cases, executor, progress)
    files = None if folder is None else CaseFiles(file_path("folder", folder), function)
    keys: list[Any] = list(range(len(given)))
    if files is not None:
        keys = [files.key(case, f"cases[{k}]") for k, case in enumerate(given)]
    read = {} if files is None else files.read(keys)
    todo = {key: case for key, case in zip(keys, given, strict=True) if key not in read}
    computed: dict[Any, CaseOutcome] = {}
    interrupted = _compute(function, todo, executor, files, computed, progress)
    outcomes = read | computed
    rows = [outcomes.get(key, _MISSING) for key in keys]
    success = [key in outcomes and not outcomes[key].error for key in keys]
    message = _describe(len(given), computed, len(todo), files, interrupted)
    values, errors, seconds = zip(*rows, strict=True) if rows else ((), (), ())
    return Sweep(given, values, errors, seconds, message, interrupted, success)  # type: ignore[arg-type]


def _compute(
    function: Callable[[Any], Any],
    todo: Mapping[Any, Any],
    executor: Executor | None,
    files: CaseFiles | None,
    computed: dict[Any, CaseOutcome],
    progress: bool,
) -> bool:
    """Compute and save the given cases.

    `todo` are the cases by key, and `computed` receives their outcomes. The `executor` calls the
    function; None means own processes. Results are saved to `files`, unless it is None. With
    `progress`, a progress bar is shown. Returns whether Ctrl-C has ended the sweep.
    """
    if executor is None:
        jobs = run_in_processes(function, todo)
    else:
        jobs = run_on_executor(function, todo, executor)
    pressed: list[bool] = []
    try:
        with tqdm(total=len(todo), unit=" cases", disable=not progress) as bar:
            for key, outcome in jobs:
                with on_interrupt(lambda: pressed.append(True), then_raise=False):  # whole files
                    computed[key] = outcome
                    if files is not None:
                        files.write(key, todo[key], outcome)
                bar.update()
                if pressed:
                    return True
    except KeyboardInterrupt:
        return True
    finally:
        jobs.close()
    return False


def _check(function: Any, cases: Any, executor: Any, progress: Any) -> tuple[Any, ...]:
    if not callable(function):
        raise TypeError(f"function is {format_value(function)}: give a function of one case")
    example = "[{'stiffness': 100.0}, {'stiffness': 200.0}]"
    if isinstance(cases, dict):
        raise TypeError(f"cases is {format_value(cases)}: give a list of cases, such as {example}")
    given = as_tuple("cases", cases, example)
    if executor is not None:
        instance(
            "executor",
            executor,
            Executor,
            "a concurrent.futures.Executor, such as client.get_executor() of a Dask client, or None",
        )
    flag("progress", progress)
    return given


def _describe(
    total: int,
    computed: Mapping[Any, CaseOutcome],
    todo: int,
    files: CaseFiles | None,
    interrupted: bool,
) -> str:
    failed = sum(bool(outcome.error) for outcome in computed.values())
    counts = {"computed": len(computed), "failed": failed, "missing": todo - len(computed)}
    parts = [f"{count} {name}" for name, count in counts.items() if count or name == "computed"]
    notes = ["interrupted from the keyboard"] if interrupted else []
    if files is not None:
        parts.append(f"{files.found} read from {files.folder}")
        lost = f"{files.damaged} files could not be read, their cases were computed again"
        name = files.function.name
        older = f"{files.outdated} results are of an older text of {name}: take a new folder"
        notes += [lost] if files.damaged else []
        notes += [f"{older} to compute them again"] if files.outdated else []
    return "; ".join([f"{total} cases: {', '.join(parts)}", *notes])
