"""The command line: how it runs a command, and what it does with mistakes."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from typing import TextIO

from tenscasadi.cli.output import BAD_INPUT, FAILED, INTERRUPTED, check_folder
from tenscasadi.cli.parser import command_parser
from tenscasadi.util.compile import CompileError


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command of the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The command and its options. Default: the arguments of the process.

    Returns
    -------
    int
        Exit code. 0: done. 1: a run diverged, no plan was found or no run is as accurate as wanted;
        what there is was written. 2: bad input, told in one line on standard error. 130:
        interrupted from the keyboard.

    Raises
    ------
    SystemExit
        After ``--help``, or for options that do not exist.

    Examples
    --------
    A shape that does not exist is told on standard error:

    >>> from tenscasadi.cli import main
    >>> main(["info", "cube"])
    2
    """
    arguments = command_parser().parse_args(argv)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            if hasattr(arguments, "output"):
                check_folder("output", arguments.output)
            return int(arguments.run(arguments))
    except BrokenPipeError:  # whoever read the output has left, as `head` does
        os.dup2(
            os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
        )  # or Python complains once more when it ends
        return FAILED
    except (ValueError, TypeError, OSError, ImportError, MemoryError, CompileError) as error:
        if isinstance(error, OSError) and error.filename is not None and error.strerror:
            _tell(f"{error.filename}: {error.strerror}")
        else:
            _tell(str(error) or "not enough memory")
        return BAD_INPUT
    except KeyboardInterrupt:
        _tell("interrupted")
        return INTERRUPTED


def _tell(text: str) -> None:
    line = " ".join(text.split())
    print(
        f"tenscasadi: {''.join(c if c.isprintable() else '?' for c in line)}", file=sys.stderr
    )  # what files say may not steer a terminal


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Tell a warning in one line, without the line of code that it comes from."""
    _tell(f"warning: {message}")
