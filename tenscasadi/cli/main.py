"""The command line: its options, and what it does with mistakes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from tenscasadi.cli import commands
from tenscasadi.cli.commands import FAILED, INTERRUPTED
from tenscasadi.cli.demos import DEMOS
from tenscasadi.util.compile import CompileError

BAD_INPUT = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command in `argv` (None: the process's arguments) and returns its exit code.

    0: done; 1: a run diverged, no plan was found or no run is as accurate as wanted (what there is was written); 2: bad input, told in one
    line on standard error.
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
    """OSError unless there is such a folder, or it can be made: told now instead of after a long run."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise OSError(f"output is {folder}: {there} {'cannot be written to' if there.is_dir() else 'is a file'}, give another folder")


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="tenscasadi", description="Tensegrity dynamics and the planning of string force densities. Units are SI.", allow_abbrev=False
    )
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    known = "\n".join(f"  {name:<16} {each.text}" for name, each in DEMOS.items())

    def command(name: str, run: Any, summary: str, epilog: str) -> argparse.ArgumentParser:
        sub = subparsers.add_parser(
            name, help=summary, description=summary, epilog=epilog, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        sub.set_defaults(run=run)
        sub.add_argument("shape", metavar="SHAPE", help="prism" if name == "plan" else "one of those below")
        sub.add_argument(
            "--output", type=Path, default=Path(), metavar="DIR", help="folder for the files it writes, made if need be (default: this one)"
        )
        return sub

    plan = command("plan", commands.run_plan, "plan the force densities that take a prism from one height to another, from rest to rest", _PLAN)
    for option, kind, default, text in (
        ("bars", int, 3, "number of bars"),
        ("radius", float, 0.5, "radius of the polygons at the start, m"),
        ("height", float, 1.0, "height at the start, m"),
        ("to-height", float, None, "height at the end, m (default: 1.2 times the height at the start)"),
        ("duration", float, 1.0, "time from start to end, s"),
        ("intervals", int, 40, "intervals of constant force density"),
        ("lower", float, 10.0, "least force density, N/m"),
        ("upper", float, 100.0, "largest force density, N/m"),
    ):
        shown = "" if default is None else f" (default: {default:g})"
        plan.add_argument(f"--{option}", type=kind, default=default, metavar="N" if kind is int else "X", help=text + shown)

    sim = command("simulate", commands.run_simulate, "simulate a shape from its default start", f"shapes and how they start:\n{known}")
    sim.add_argument("--t-end", type=float, metavar="S", help="end of the simulation, s (default: 1 to 3 s, by shape)")
    sim.add_argument("--step", type=float, default=1e-3, metavar="S", help="largest time step, s (default: 0.001)")
    sim.add_argument(
        "--coordinates", default="reduced", metavar="C", help='"reduced" (default) or "full": the class-one nodes and joint forces of the paper'
    )
    sim.add_argument("--gravity", type=float, metavar="G", help="m/s² downwards, 0: none (default: by shape)")
    sim.add_argument("--save-every", type=int, metavar="N", help="steps from one kept row to the next (default: about 1000 rows)")
    sim.add_argument("--projection", type=int, metavar="N", help="put bars and joints right after every N steps (default: never)")
    sim.add_argument("--uncompiled", action="store_true", help="use CasADi's virtual machine even where there is a C compiler")
    sim.add_argument("--gif", action="store_true", help="write an animation too")

    trade = command(
        "tradeoff", commands.run_tradeoff, "measure how fast and how accurate each scheme is", f"{_TRADEOFF}\n\nshapes and how they start:\n{known}"
    )
    trade.add_argument("--t-end", type=float, metavar="S", help="end of the simulation, s (default: 1 to 3 s, by shape)")
    trade.add_argument(
        "--steps", type=float, nargs="+", default=[0.02, 0.01, 0.005, 0.002, 0.001], metavar="S", help="steps, s (default: 0.02 … 0.001)"
    )
    trade.add_argument("--rtol", type=float, nargs="+", default=[1e-4, 1e-7, 1e-10], metavar="R", help="tolerances (default: 1e-4 1e-7 1e-10)")
    trade.add_argument("--tolerance", type=float, metavar="X", help="wanted accuracy, m: names the fastest run within it")
    trade.add_argument("--single", action="store_true", help="measure everything in single precision, too")
    trade.add_argument("--uncompiled", action="store_true", help="use CasADi's virtual machine even where there is a C compiler")

    command("info", commands.run_info, "describe a shape: members, masses, equilibrium, equations, stable step", f"shapes:\n{known}")
    return parser


_PLAN = """\
The prism starts in its equilibrium shape and ends in the equilibrium shape of the other height, which the same bars allow.
The plan is found with IPOPT and checked by a simulation with steps ten times finer, whose distance from the goal is printed.
Bounds near the forces that hold the prism make an easy plan; wide ones may take many iterations."""


_TRADEOFF = """\
Every scheme is run with every step (and error control with every --rtol), with and without Projection, and compared with a reference that two
schemes agree on. Times do not hold the compilation, which is told apart. Ctrl-C ends the study and keeps what there is."""
