"""The commands of the command line: their options and their help."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from tenscasadi.cli import commands, plan
from tenscasadi.cli.completion import FILE, FOLDER, SHAPE, SOURCE, run_completion
from tenscasadi.cli.exchange import run_export, run_import
from tenscasadi.cli.output import BAD_INPUT
from tenscasadi.cli.source import SHAPES
from tenscasadi.cli.texts import run_new, run_schema
from tenscasadi.cli.view import run_view
from tenscasadi.util.version import __version__

_Options = dict[str, dict[str, Any]]


class _Parser(argparse.ArgumentParser):
    """Parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


class Command(NamedTuple):
    """A command: its function, the one-line summary, the end of the help, what is named without a dash, and the options."""

    run: Callable[[argparse.Namespace], int]
    summary: str
    epilog: str
    named: _Options
    options: _Options


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = _Parser(
        prog="tenscasadi", description=_DESCRIPTION, epilog=_EPILOG, allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"tenscasadi {__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        sub = subparsers.add_parser(
            name,
            help=command.summary,
            description=command.summary,
            epilog=command.epilog,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.set_defaults(run=command.run, parser=parser)
        for option, settings in (command.named | command.options).items():
            completed = {key: value for key, value in settings.items() if key != "complete"}
            action = sub.add_argument(option, **completed)
            if "complete" in settings:
                action.complete = settings["complete"]  # type: ignore[attr-defined]  # what shtab reads
    return parser


def _number(text: str, kind: type = float, metavar: str = "X", **settings: Any) -> dict[str, Any]:
    """Describe an option that takes a number; its default is told where it is a number."""
    default = settings.get("default")
    shown = f" (default: {default:g})" if isinstance(default, (int, float)) else ""
    return {"type": kind, "metavar": metavar, "help": text + shown, **settings}


_FLAG: dict[str, Any] = {"action": "store_true"}
_OUTPUT: _Options = {
    "--output": {
        "type": Path,
        "default": Path(),
        "metavar": "DIR",
        "help": "folder for the files it writes, made if need be (default: this one)",
        "complete": FOLDER,
    }
}
_SOURCE: _Options = {
    "source": {
        "metavar": "SHAPE|FILE",
        "help": "one of the shapes below, or a scene file (.toml)",
        "complete": SOURCE,
    }
}
_THING: _Options = {
    "source": {
        "metavar": "SHAPE|FILE",
        "help": "a shape, a scene file (.toml), a trajectory or plan (.npz)",
        "complete": FILE,
    }
}
_T_END = {"--t-end": _number("end of the simulation, s (default: the scene's)", metavar="S")}
_UNCOMPILED: _Options = {
    "--uncompiled": {
        "help": "use CasADi's virtual machine even where there is a C compiler",
        **_FLAG,
    }
}

_PLAN_OPTIONS = {
    **{
        f"--{name.replace('_', '-')}": _number(f"{text} (default: {default:g})", type(default))
        for name, (text, default) in plan.PRISM.items()
    },
    "--to-height": _number(
        "prism: height at the end, m (default: 1.2 times the height at the start)"
    ),
    "--intervals": _number(
        "prism: this many intervals, by multiple shooting and IPOPT (default: what suits the problem)",
        int,
        "N",
    ),
}
_SIMULATE_OPTIONS: _Options = {
    **_T_END,
    "--step": _number("largest time step, s (default: the scene's, 0.001 for shapes)", metavar="S"),
    "--coordinates": {
        "help": '"reduced" or "full": the class-one nodes and joint forces of the paper (default: the scene\'s)',
        "metavar": "C",
    },
    "--gravity": _number("m/s² downwards, 0: none (default: the scene's)", metavar="G"),
    "--save-every": _number(
        "steps from one kept row to the next (default: about 1000 rows)", int, "N"
    ),
    "--projection": _number(
        "put bars and joints right after every N steps (default: the scene's)", int, "N"
    ),
    **_UNCOMPILED,
    "--gif": {"help": "write an animation too", **_FLAG},
    "--mp4": {"help": "write a film too", **_FLAG},
}
_TRADEOFF_OPTIONS: _Options = {
    **_T_END,
    "--steps": _number(
        "steps, s (default: 0.02 … 0.001)",
        metavar="S",
        nargs="+",
        default=[0.02, 0.01, 0.005, 0.002, 0.001],
    ),
    "--rtol": _number(
        "tolerances (default: 1e-4 1e-7 1e-10)", metavar="R", nargs="+", default=[1e-4, 1e-7, 1e-10]
    ),
    "--tolerance": _number("wanted accuracy, m: names the fastest run within it"),
    "--single": {"help": "measure everything in single precision, too", **_FLAG},
    **_UNCOMPILED,
}
_SHELL: _Options = {"shell": {"choices": ("bash", "zsh"), "help": "whose script"}}
_SHAPE: _Options = {
    "shape": {"metavar": "SHAPE", "help": "one of the shapes below", "complete": SHAPE}
}
_THINGS: _Options = {
    "things": {
        "metavar": "SHAPE|FILE",
        "nargs": "+",
        "help": "shapes, scene files (.toml), trajectories, rollouts, plans (.npz)",
        "complete": FILE,
    }
}
_FOREIGN: _Options = {
    "source": {
        "metavar": "FILE",
        "help": "file of another tool; its ending says which",
        "complete": FILE,
    }
}
_OUT: _Options = {
    "out": {
        "metavar": "OUT",
        "type": Path,
        "help": "file to write; its ending says the format",
        "complete": FILE,
    }
}
_IMPORT_OPTIONS: _Options = {
    "--length-unit": _number("NTRT: its unit of length, m", default=1.0),
    "--ball-joints": {
        "action": argparse.BooleanOptionalAction,
        "default": True,
        "help": "NTRT: rods that share a node may turn there (default)",
    },
    "--lenient": {"help": "leave out what a scene cannot have, and list it", **_FLAG},
}
_VIEW_OPTIONS: _Options = {
    "--html": {
        "type": Path,
        "metavar": "OUT",
        "help": "write one page that plays in any browser, instead of showing it now",
        "complete": FILE,
    },
    "--live": {"help": "simulate in real time: sliders for the strings, nodes to pull at", **_FLAG},
    "--save": {
        "type": Path,
        "metavar": "OUT",
        "help": "with --live: the file that the button Save writes (.npz)",
        "complete": FILE,
    },
    "--host": {
        "default": "127.0.0.1",
        "metavar": "HOST",
        "help": "address to listen on (default: 127.0.0.1, this machine alone)",
    },
    "--port": _number("port (default: one that is free)", int, "N"),
    "--no-browser": {"help": "open no browser: print the address", **_FLAG},
    "--color": {
        "choices": ("tension", "force density"),
        "default": "tension",
        "help": "quantity that colors the strings (default: tension)",
    },
    "--speed": _number("simulated seconds in each second", default=1.0),
    "--follow": {"help": "keep the first motion in the middle", **_FLAG},
}

_DESCRIPTION = "Tensegrity dynamics and the planning of string force densities. Units are SI."
_EPILOG = """\
Files are named after the shape or scene file: `tenscasadi plan reach.toml` writes reach-plan.npz. The tab key completes commands and files
after `eval "$(tenscasadi completion bash)"`, in ~/.bashrc for good (or zsh, ~/.zshrc)."""

_PLAN = """\
A scene file is planned as its [plan] says. The shape prism starts in its equilibrium shape and ends in the equilibrium shape of the other
height, which the same bars allow. The plan is checked by a simulation in finer steps, whose distance from the goal is printed.
Bounds near the forces that hold the structure make an easy plan; wide ones may take many iterations."""

_TRADEOFF = """\
Every scheme is run with every step (and error control with every --rtol), with and without Projection, and compared with a reference that two
schemes agree on. Times do not hold the compilation, which is told apart. Ctrl-C ends the study and keeps what there is."""

_NEW = """\
    tenscasadi new prism > my.toml
    tenscasadi simulate my.toml"""

_VIEW = "Several motions lie over each other; the first one is solid. Ctrl-C ends the viewer."

_EXPORT = """\
Scenes: .xml (MuJoCo), .mat (MATLAB: MOTES), .toml (a scene file without formulas).
Trajectories and plans (.npz): .csv, .mat (MATLAB), .pvd (ParaView)."""

_IMPORT = """\
MuJoCo: .xml; MATLAB: .mat of MOTES or TsgFEM; NTRT: .yaml.
Parts without a counterpart in a scene file are errors; --lenient leaves them out and lists them."""

_COMPLETION = """\
To turn it on in this shell: eval "$(tenscasadi completion bash)". For good: the same line in ~/.bashrc (zsh: after compinit in ~/.zshrc)."""

_SHAPES = "\n".join(f"  {name:<16} {text}" for name, text in SHAPES.items())
_STARTS = f"shapes and how they start:\n{_SHAPES}"
_PLAIN = f"shapes:\n{_SHAPES}"

COMMANDS = {
    "new": Command(
        run_new, "print a commented scene file to start from", f"{_NEW}\n\n{_PLAIN}", _SHAPE, {}
    ),
    "info": Command(
        commands.run_info,
        "describe a scene: members, masses, equilibrium, equations, stable step; check its file",
        _PLAIN,
        _SOURCE,
        _OUTPUT,
    ),
    "simulate": Command(
        commands.run_simulate,
        "simulate a scene from its start",
        _STARTS,
        _SOURCE,
        _OUTPUT | _SIMULATE_OPTIONS,
    ),
    "plan": Command(
        plan.run_plan,
        "plan force densities: as a scene file asks, or from one height of a prism to another",
        _PLAN,
        _SOURCE,
        _OUTPUT | _PLAN_OPTIONS,
    ),
    "view": Command(
        run_view,
        "show scenes, motions and plans in a browser, or write them as a page",
        f"{_VIEW}\n\n{_PLAIN}",
        _THINGS,
        _VIEW_OPTIONS,
    ),
    "tradeoff": Command(
        commands.run_tradeoff,
        "measure how fast and how accurate each scheme is",
        f"{_TRADEOFF}\n\n{_STARTS}",
        _SOURCE,
        _OUTPUT | _TRADEOFF_OPTIONS,
    ),
    "export": Command(
        run_export,
        "write a scene, a trajectory or a plan for other tools",
        _EXPORT,
        _THING | _OUT,
        {},
    ),
    "import": Command(
        run_import,
        "write what another tool wrote as a scene file",
        _IMPORT,
        _FOREIGN | _OUT,
        _IMPORT_OPTIONS,
    ),
    "schema": Command(
        run_schema,
        "print the JSON Schema of scene files, for editors",
        "    tenscasadi schema > scene.schema.json",
        {},
        {},
    ),
    "completion": Command(
        run_completion,
        "print the script that lets a shell complete what is typed",
        _COMPLETION,
        _SHELL,
        {},
    ),
}
