"""Entry point of the command line, with its error handling."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Sequence
from typing import TextIO

from tenscasadi.cli import analyse, commands, exchange, plan, texts, view
from tenscasadi.cli.parser import Command, parse
from tenscasadi.cli.report import BAD_INPUT, FAILED, INTERRUPTED
from tenscasadi.util.compile import CompileError
from tenscasadi.util.troubleshooting import append_address, find_address

COMMANDS = {
    "new": Command(texts.print_template),
    "info": Command(commands.describe),
    "analyse": Command(analyse.analyze_scene),
    "simulate": Command(commands.simulate_scene, "simulation", commands.find_fields),
    "plan": Command(plan.plan_motion, "plan", plan.find_fields),
    "control": Command(plan.control_motion, "closed_loop", plan.find_loop_fields),
    "view": Command(view.show),
    "tradeoff": Command(commands.compare_schemes),
    "export": Command(exchange.export_file),
    "import": Command(exchange.import_file),
    "schema": Command(texts.print_schema),
    "completion": Command(texts.print_completion),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command of the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The command and its options. Default: the arguments of the process.

    Returns
    -------
    int
        Exit code. 0: success. 1: a run diverged, no plan was found, or no run is accurate enough;
        results so far are written. 2: invalid input, with a line on standard error. 130: interrupted
        from the keyboard.

    Raises
    ------
    SystemExit
        After ``--help``, or for options that do not exist.

    Examples
    --------
    An unknown shape is an error:

    >>> from tenscasadi.cli import main
    >>> main(["info", "cube"])
    2
    """
    words = sys.argv[1:] if argv is None else argv
    code, fault = BAD_INPUT, ""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            return parse(words, COMMANDS)()
    except BrokenPipeError:  # the reader of the output has left, as `head` does
        # or Python complains once more when it ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except (ValueError, TypeError, OSError, ImportError, MemoryError, CompileError) as error:
        named = isinstance(error, OSError) and error.filename is not None and error.strerror
        fault = f"{error.filename}: {error.strerror}" if named else str(error)  # type: ignore[union-attr]
    except KeyboardInterrupt:
        code, fault = INTERRUPTED, "interrupted"
    _tell(append_address(fault) or "not enough memory")
    if "--json" in words:
        address = find_address(fault)
        see = {"see": address} if address else {}
        print(json.dumps({"success": False, "message": fault, **see}))
    return code


def _tell(text: str) -> None:
    line = " ".join(text.split())
    print(
        f"tenscasadi: {''.join(c if c.isprintable() else '?' for c in line)}", file=sys.stderr
    )  # control characters in files must not reach the terminal


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning message in one line.

    Its place in the code is omitted. The arguments are those of `warnings.showwarning`.
    """
    _tell(f"warning: {message}")
