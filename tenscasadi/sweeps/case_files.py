"""Results of a sweep's cases, and their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.sweeps.identity import PLAIN, case_key, describe_case, hash_case, identify
from tenscasadi.util import archive
from tenscasadi.util.archive import Fields

_FORMAT = "tenscasadi case 1"
_VALUE = "value."  # before the names of results in files


class CaseOutcome(NamedTuple):
    """Result of one case of a sweep.

    Attributes
    ----------
    values : dict
        Results by name.
    error : str
        Traceback if the case failed, otherwise "".
    seconds : float
        Wall time [s].
    """

    values: dict[str, Any]
    error: str
    seconds: float


def check_results(returned: Any) -> dict[str, Any]:
    """Convert a case's result to numbers, text and arrays by name.

    The result is the value `returned` by the user's function. None becomes an empty mapping. Raises
    TypeError.
    """
    if returned is None:
        return {}
    results = dict(returned) if isinstance(returned, Mapping) else {"result": returned}
    for name, value in results.items():
        if not isinstance(name, str):
            raise TypeError(f"the function returned a result named {name!r}: name results by text")
        results[name] = _read_result(name, value)
    return results


def _read_result(name: str, value: Any) -> Any:
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        array = np.empty((), dtype=object)
    if array.dtype.kind not in PLAIN:
        cure = "return numbers, text, or arrays of them (NaN for None)"
        raise TypeError(f"result {name!r} is of type {type(value).__name__}: {cure}")
    return array.item() if array.ndim == 0 else array


class CaseFiles:
    """Folder with one .npz file for each finished case of a sweep.

    Raises TypeError, ValueError, OSError.

    Attributes
    ----------
    found, damaged, outdated : int
        Number of files read so far: of finished cases, of no case, of an older text of the
        function.
    """

    def __init__(self, folder: Path, function: Callable[..., Any]) -> None:
        self.function = identify(function)
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.found = self.damaged = self.outdated = 0

    def key(self, case: Any, field: str) -> str:
        """Compute the key that identifies a case, its file name.

        `field` is the name of the case in messages. Raises TypeError.
        """
        return case_key(self.function.key, case, field)

    def write(self, key: str, case: Any, outcome: CaseOutcome) -> None:
        """Write a case with its outcome atomically.

        `key` is the result of the method `key`. Raises OSError.
        """
        own = self.function
        content = {
            **{"case": describe_case(case), "function": own.name, "source": own.source},
            **{"home": own.home, "error": outcome.error, "seconds": outcome.seconds},
            **{_VALUE + name: value for name, value in outcome.values.items()},
        }
        archive.save(self.folder / f"{key}.npz", _FORMAT, content)

    def read(self, keys: Sequence[str]) -> dict[str, CaseOutcome]:
        """Read the results of cases that have finished without error.

        They are found by the keys of the cases. Raises ValueError if they are of another function.
        """
        found, own = {}, self.function
        for key in dict.fromkeys(keys):
            try:
                outcome, source, home = archive.load(
                    self.folder / f"{key}.npz", _FORMAT, "case", partial(_read, own.key, key)
                )
            except FileNotFoundError:
                continue
            except ValueError:
                self.damaged += 1
                continue
            if home and own.home and home != own.home and source != own.source:
                whose = f"results of {own.name} of {home}, not of {own.home}"
                raise ValueError(f"folder {self.folder} holds {whose}: give each its own folder")
            if not outcome.error:
                found[key] = outcome
                self.found += 1
                self.outdated += source != own.source
        return found


def _read(function: str, key: str, content: Fields) -> tuple[CaseOutcome, str, str]:
    """Read a result with the source hash and module of its function.

    `content` are the fields of the file, and `key` is the case's key. `function` is the function's
    name. Raises ValueError.
    """
    if hash_case(function, str(content.array("case", "U", 0))) != key:
        raise ValueError("it is of another case")
    values = {
        name: value.item() if value.ndim == 0 else value
        for name, value in content.within(_VALUE).items()
    }
    error, seconds = str(content.array("error", "U", 0)), float(content.array("seconds", "f", 0))
    home = str(content.array("home", "U", 0)) if "home" in content else ""
    return CaseOutcome(values, error, seconds), str(content.array("source", "U", 0)), home
