"""Sweeps: one function of many independent cases, on the cores of this machine or on a cluster, each result on disk at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from typing import Any

from tqdm import tqdm

from tenscasadi.sweeps.case_files import CaseFiles, Outcome
from tenscasadi.sweeps.sweep_table import Sweep
from tenscasadi.sweeps.workers import run_in_processes, run_on_executor
from tenscasadi.util.interrupts import on_interrupt
from tenscasadi.util.validate import file_path, flag, instance, listed, shown

_MISSING = Outcome({}, "", float("nan"))


def sweep(
    function: Callable[[Any], Any],
    cases: Iterable[Any],
    executor: Executor | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Sweep:
    """Compute a function of many independent cases, such as structures, plans or seeds.

    Parameters
    ----------
    function : callable
        Function of one case. It returns a dict of numbers, text and arrays of these, or one of
        them, which is then named ``result``.
    cases : iterable
        Cases. Dicts by text, whose values are the columns of the table, or any other value. With a
        `folder`, cases hold None, numbers, text, NumPy arrays, lists, tuples and dicts of these,
        structures, scenes, models, and options that are dataclasses, such as schemes.
    executor : concurrent.futures.Executor, optional
        Who computes: processes of this machine, as many as it has cores and each with one thread,
        by default. Dask's ``client.get_executor()`` computes on a cluster.
    folder : str or PathLike, optional
        Folder of results. Each finished case is written there at once, and what is found there is
        not computed again.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Sweep
        Table of cases and results. A case that raises, or whose worker dies, is recorded with its
        traceback, and the others go on. So does Ctrl-C end the sweep early: what has finished is
        kept.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, a case holds what a folder of results cannot tell, the folder is that
        of another script's function of the same name, or other processes cannot import the
        function.
    RuntimeError
        Worker processes cannot begin, as in a script without ``if __name__ == "__main__":``.
    OSError
        The folder cannot be made or written.

    See Also
    --------
    Sweep : The table.

    Notes
    -----
    A case is identified by what it holds, and by the name of the function with what that holds: the
    arguments of a `functools.partial`, the attributes of its object, numbers, text, arrays,
    structures, scenes and models in its closure and defaults. Its file is read without running what
    is in it (no pickle).
    Failed cases are computed again in the next sweep of the folder. Where the text of the function
    has changed since, the message says how many results are older; what else the function calls is
    not compared: take a new folder when that changes.

    Processes are started anew, so that a script has to guard what it runs by ``if __name__ ==
    "__main__":``. Compiled code is shared among them, also by machines that share a home folder
    (``TENSCASADI_CACHE`` names another one). Threads share one CasADi, which computes one case
    after the other at best: prefer processes.

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
    keys: list[Any] = (
        list(range(len(given)))
        if files is None
        else [files.key(case, f"cases[{k}]") for k, case in enumerate(given)]
    )
    outcomes: dict[Any, Outcome] = {} if files is None else dict(files.read(keys))
    read = set(outcomes)
    todo = {key: case for key, case in zip(keys, given, strict=True) if key not in read}
    jobs = (
        run_in_processes(function, todo)
        if executor is None
        else run_on_executor(function, todo, executor)
    )
    interrupted, pressed = False, list[bool]()
    try:
        with tqdm(total=len(todo), unit=" cases", disable=not progress) as bar:
            for key, outcome in jobs:
                with on_interrupt(
                    lambda: pressed.append(True), then_raise=False
                ):  # what is done is written whole
                    outcomes[key] = outcome
                    if files is not None:
                        files.write(key, todo[key], outcome)
                bar.update()
                if pressed:
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        interrupted = True
    finally:
        jobs.close()
    rows = [outcomes.get(key, _MISSING) for key in keys]
    success = [key in outcomes and not outcomes[key].error for key in keys]
    computed = {key: outcome for key, outcome in outcomes.items() if key not in read}
    message = _describe(len(given), computed, len(todo), files, interrupted)
    values, errors, seconds = zip(*rows, strict=True) if rows else ((), (), ())
    return Sweep(given, values, errors, seconds, message, interrupted, success)  # type: ignore[arg-type]


def _check(function: Any, cases: Any, executor: Any, progress: Any) -> tuple[Any, ...]:
    if not callable(function):
        raise TypeError(f"function is {shown(function)}: give a function of one case")
    example = "[{'stiffness': 100.0}, {'stiffness': 200.0}]"
    if isinstance(cases, dict):
        raise TypeError(f"cases is {shown(cases)}: give a list of cases, such as {example}")
    given = listed("cases", cases, example)
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
    computed: Mapping[Any, Outcome],
    todo: int,
    files: CaseFiles | None,
    interrupted: bool,
) -> str:
    failed, missing = (
        sum(bool(outcome.error) for outcome in computed.values()),
        todo - len(computed),
    )
    parts = (
        [f"{len(computed)} computed"]
        + [f"{failed} failed"] * (failed > 0)
        + [f"{missing} missing"] * (missing > 0)
    )
    if files is not None:
        parts.append(f"{files.found} read from {files.folder}")
    text = f"{total} cases: " + ", ".join(parts) + "; interrupted from the keyboard" * interrupted
    if files is not None and files.damaged:
        text += f"; {files.damaged} files could not be read, their cases were computed again"
    if files is not None and files.outdated:
        text += f"; {files.outdated} results are of an older text of {files.name}: take a new folder to compute them again"
    return text
