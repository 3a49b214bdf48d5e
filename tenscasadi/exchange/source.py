"""Imported files of other programs, with a list of changes."""

from __future__ import annotations

import warnings
from pathlib import Path

from tenscasadi.schema.reading import SceneFileError
from tenscasadi.util.validate import FilePath, file_path, flag

DEEPEST = 100  # nesting of elements; MuJoCo reads deeper bodies badly


class InexactImportWarning(UserWarning):
    """Warning that an imported scene differs from its file.

    Parameters
    ----------
    file : str
        Name of the file.
    changes : tuple of str
        Parts of the file that were left out or changed.
    """

    def __init__(self, file: str, changes: tuple[str, ...]) -> None:
        count = f"{len(changes)} change{'s' * (len(changes) != 1)}"
        super().__init__(f"{file} was imported with {count}: {'; '.join(changes)}")
        self.file, self.changes = file, changes

    def __reduce__(self) -> tuple[type, tuple[str, tuple[str, ...]]]:
        return type(self), (self.file, self.changes)


class Source:
    """File of another program that is imported.

    Parameters
    ----------
    path : path-like
        The file.
    strict : bool
        Whether features without a counterpart are errors. Otherwise they are left out.

    Attributes
    ----------
    path : Path
        The file.
    changes : list of str
        Features that were omitted or changed.
    """

    def __init__(self, path: FilePath, strict: bool = True) -> None:
        flag("strict", strict)
        self.path, self.strict = file_path("path", path), strict
        self.changes: list[str] = []

    def read(self, path: Path | None = None, most: int = 16_000_000) -> bytes:
        """Read a regular file of at most `most` bytes.

        `path` is the file; None means the main one. Raises SceneFileError, FileNotFoundError.
        """
        place = self.path if path is None else path
        if not place.exists():
            raise FileNotFoundError(2, "No such file", str(place))
        name = place.name or str(place)
        if not place.is_file():  # opening a FIFO would wait for another process
            raise SceneFileError("it is no regular file: give the path of one", name)
        try:
            with open(place, "rb") as file:
                content = file.read(most + 1)
        except OSError as error:
            raise SceneFileError(
                f"it cannot be read ({error.strerror}): give a file that can", name
            ) from None
        if len(content) > most:
            raise SceneFileError(f"it has more than {most / 1e6:g} MB: give a smaller file", name)
        return content

    def leave_out(self, error: ValueError) -> None:
        """Omit a feature that has no counterpart.

        Raises the error if the import is strict, with the cure to import leniently.
        """
        if self.strict:
            cure = "give strict=False (--lenient) to import the file without it"
            error.args = (f"{error}, or {cure}", *error.args[1:])
            raise error
        self.note(str(error).removeprefix(f"{self.path.name}, "))

    def note(self, change: str) -> None:
        """Add a change to the list, once."""
        if change not in self.changes:
            self.changes.append(change)

    def report(self) -> None:
        """Warn of all changes, for the caller of the importer."""
        if self.changes:
            warning = InexactImportWarning(self.path.name, tuple(self.changes))
            warnings.warn(warning, stacklevel=3)
