"""The command line: its options, and what it does with mistakes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from tenscasadi.cli import commands
from tenscasadi.cli.commands import FAILED, INTERRUPTED
from tenscasadi.cli.demos import DEMOS
from tenscasadi.util.compile import CompileError

BAD_INPUT = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command of the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The command and its options. Default: the arguments of the process.

    Returns
    -------
    int
        Exit code. 0: done. 1: a run diverged, no plan was found or no run is as accurate as wanted; what there is was written. 2: bad input,
        told in one line on standard error. 130: interrupted from the keyboard.

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
    arguments = _parser().parse_args(argv)
    try:
        _check_output(arguments.output)
        return int(arguments.run(arguments))
    except BrokenPipeError:  # whoever read the output has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains once more when it ends
        return FAILED
    except (ValueError, TypeError, OSError, CompileError) as error:
        print(f"tenscasadi: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("tenscasadi: interrupted", file=sys.stderr)
        return INTERRUPTED


def _check_output(folder: Path) -> None:
    """Raise OSError unless there is such a folder, or it can be made: told now instead of after a long run."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise OSError(f"output is {folder}: {there} {'cannot be written to' if there.is_dir() else 'is a file'}, give another folder")


class _Parser(argparse.ArgumentParser):
    """Parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="tenscasadi", description="Tensegrity dynamics and the planning of string force densities. Units are SI.", allow_abbrev=False
    )
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (run, summary, epilog, options) in _COMMANDS.items():
        sub = subparsers.add_parser(
            name, help=summary, description=summary, epilog=epilog, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        sub.set_defaults(run=run)
        sub.add_argument("shape", metavar="SHAPE", help="prism" if name == "plan" else "one of those below")
        for option, settings in (_OUTPUT | options).items():
            sub.add_argument(option, **settings)
    return parser


def _number(text: str, kind: type = float, metavar: str = "X", **settings: Any) -> dict[str, Any]:
    """Describe an option that takes a number; its default is told where it is a number."""
    default = settings.get("default")
    shown = f" (default: {default:g})" if isinstance(default, (int, float)) else ""
    return {"type": kind, "metavar": metavar, "help": text + shown, **settings}


_Options = dict[str, dict[str, Any]]

_FLAG: dict[str, Any] = {"action": "store_true"}
_OUTPUT: _Options = {
    "--output": {"type": Path, "default": Path(), "metavar": "DIR", "help": "folder for the files it writes, made if need be (default: this one)"}
}
_T_END = {"--t-end": _number("end of the simulation, s (default: 1 to 3 s, by shape)", metavar="S")}
_UNCOMPILED: _Options = {"--uncompiled": {"help": "use CasADi's virtual machine even where there is a C compiler", **_FLAG}}

_PLAN_OPTIONS = {
    "--bars": _number("number of bars", int, "N", default=3),
    "--radius": _number("radius of the polygons at the start, m", default=0.5),
    "--height": _number("height at the start, m", default=1.0),
    "--to-height": _number("height at the end, m (default: 1.2 times the height at the start)"),
    "--duration": _number("time from start to end, s", default=1.0),
    "--intervals": _number("intervals of constant force density", int, "N", default=40),
    "--lower": _number("least force density, N/m", default=10.0),
    "--upper": _number("largest force density, N/m", default=100.0),
}
_COORDINATES = '"reduced" (default) or "full": the class-one nodes and joint forces of the paper'
_SIMULATE_OPTIONS: _Options = {
    **_T_END,
    "--step": _number("largest time step, s", metavar="S", default=1e-3),
    "--coordinates": {"help": _COORDINATES, "default": "reduced", "metavar": "C"},
    "--gravity": _number("m/s² downwards, 0: none (default: by shape)", metavar="G"),
    "--save-every": _number("steps from one kept row to the next (default: about 1000 rows)", int, "N"),
    "--projection": _number("put bars and joints right after every N steps (default: never)", int, "N"),
    **_UNCOMPILED,
    "--gif": {"help": "write an animation too", **_FLAG},
}
_TRADEOFF_OPTIONS: _Options = {
    **_T_END,
    "--steps": _number("steps, s (default: 0.02 … 0.001)", metavar="S", nargs="+", default=[0.02, 0.01, 0.005, 0.002, 0.001]),
    "--rtol": _number("tolerances (default: 1e-4 1e-7 1e-10)", metavar="R", nargs="+", default=[1e-4, 1e-7, 1e-10]),
    "--tolerance": _number("wanted accuracy, m: names the fastest run within it"),
    "--single": {"help": "measure everything in single precision, too", **_FLAG},
    **_UNCOMPILED,
}

_PLAN = """\
The prism starts in its equilibrium shape and ends in the equilibrium shape of the other height, which the same bars allow.
The plan is found with IPOPT and checked by a simulation with steps ten times finer, whose distance from the goal is printed.
Bounds near the forces that hold the prism make an easy plan; wide ones may take many iterations."""

_TRADEOFF = """\
Every scheme is run with every step (and error control with every --rtol), with and without Projection, and compared with a reference that two
schemes agree on. Times do not hold the compilation, which is told apart. Ctrl-C ends the study and keeps what there is."""

_SHAPES = "\n".join(f"  {name:<16} {each.text}" for name, each in DEMOS.items())
_STARTS = f"shapes and how they start:\n{_SHAPES}"

# What runs, the summary, the end of the help, and the options.
_COMMANDS: dict[str, tuple[Callable[[argparse.Namespace], int], str, str, _Options]] = {
    "plan": (commands.run_plan, "plan the force densities that take a prism from one height to another, from rest to rest", _PLAN, _PLAN_OPTIONS),
    "simulate": (commands.run_simulate, "simulate a shape from its default start", _STARTS, _SIMULATE_OPTIONS),
    "tradeoff": (commands.run_tradeoff, "measure how fast and how accurate each scheme is", f"{_TRADEOFF}\n\n{_STARTS}", _TRADEOFF_OPTIONS),
    "info": (commands.run_info, "describe a shape: members, masses, equilibrium, equations, stable step", f"shapes:\n{_SHAPES}", {}),
}
