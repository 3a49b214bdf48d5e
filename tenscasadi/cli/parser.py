"""Command-line parser, built from the commands' signatures and docstrings."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple, NoReturn, get_args, get_origin, get_type_hints

from tenscasadi.cli.report import BAD_INPUT, CommandReport
from tenscasadi.cli.source import TEMPLATES, read_title
from tenscasadi.io.document import Change
from tenscasadi.schema.definitions import OneOf, parameter_texts
from tenscasadi.schema.field_types import Flag, Numbers, Word
from tenscasadi.version import __version__


class Command(NamedTuple):
    """Command, and the scene-file table whose fields are options.

    `run` executes it, `section` is the name of the table, and `find_fields` returns its fields.
    """

    run: Callable[..., int]
    section: str = ""
    find_fields: Callable[[], Any] = dict


Commands = Mapping[str, Command]

_DESCRIPTION = "Tensegrity dynamics and the planning of string force densities. Units are SI."
_EPILOG = """\
Files are named after the template or scene file: `tenscasadi plan reach.toml` writes reach-plan.npz. The tab key completes commands and files
after `eval "$(tenscasadi completion bash)"`, in ~/.bashrc for good (or zsh, ~/.zshrc)."""


class _Parser(argparse.ArgumentParser):
    """Argument parser whose errors have one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


class CommandOption(NamedTuple):
    """Option or argument of a command.

    `type` is that of its value, `default` the value if it is missing, and `text` the help.
    """

    type: Any
    default: Any
    text: str


def parse(argv: Sequence[str], commands: Commands) -> Callable[[], int]:
    """Parse arguments (`argv`), and return the command ready to run.

    Raises SystemExit.
    """
    parser = command_parser(commands, argv[0] if argv else "")
    namespace, rest = parser.parse_known_args(argv)
    given = vars(namespace)
    command, fields = commands[given.pop("command")], given.pop("fields")
    parameters = inspect.signature(command.run).parameters
    if rest and ("changes" not in parameters or not rest[0].startswith("--")):
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    own = {name: value for name, value in given.items() if name in parameters}
    if "changes" in parameters:
        sets = [text.partition("=") for text in given.pop("set") or []]
        words = [part for word in rest for part in word.split("=", 1)]
        own["changes"] = [
            *_build_changes(command.section, [(_flag(name), given.pop(name)) for name in fields]),
            *_build_changes("numbers", zip(words[::2], [*words[1::2], ""], strict=False)),
            *(Change(f"--set {key}={value}", key, value) for key, _, value in sets),
        ]
        own["report"] = CommandReport(
            **{name: own for name, own in given.items() if name in _REPORT}
        )
    if "parser" in parameters:
        own["parser"] = command_parser(commands)
    return partial(command.run, **own)


def _build_changes(section: str, options: Any) -> Iterator[Change]:
    for flag, value in options:
        if value is not None:
            key = flag.lstrip("-").replace("-", "_")
            yield Change(f"{flag} {value}", f"{section}.{key}", str(value))


def command_parser(commands: Commands, only: str | None = None) -> argparse.ArgumentParser:
    """Build the parser of all commands.

    Only the command `only` gets the fields of its scene-file table as options; by default all do.
    """
    parser = _Parser(
        prog="tenscasadi", description=_DESCRIPTION, epilog=_EPILOG, allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"tenscasadi {__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    titles = "\n".join(f"  {name:<16} {read_title(name)}" for name in TEMPLATES)
    for name, command in commands.items():
        summary, _, more = (inspect.getdoc(command.run) or "").partition("\n\n")
        text = more.partition("Parameters\n---")[0].rstrip()
        options = _find_options(command.run)
        scenes = {"source", "template", "things"} & options.keys() and name != "import"
        sub = subparsers.add_parser(
            name,
            help=summary,
            description=summary,
            epilog=f"{text}\n\ntemplates:\n{titles}" if scenes else text,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        known = command.find_fields() if only in (None, name) else {}
        fields = {
            field: CommandOption(_read_type(own.type), None, own.text)
            for field, own in known.items()
            if isinstance(own.type, (Numbers, Flag, Word, OneOf)) and field not in options
        }
        for option, own in (options | fields).items():
            _add_option(sub, option, own)
        sub.set_defaults(fields=list(fields))
    return parser


def _read_type(kind: Any) -> Any:
    return Literal[kind.options] if isinstance(kind, Word) and kind.options else str


@cache
def _find_options(function: Callable[..., Any]) -> dict[str, CommandOption]:
    """Find a command's options from the signature of its function.

    A parameter `report` stands for the fields of `CommandReport`.
    """
    texts = parameter_texts(function)
    hints = get_type_hints(function, include_extras=True)
    found: dict[str, CommandOption] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name == "report":
            found |= _REPORT
        elif name not in ("changes", "parser"):
            found[name] = CommandOption(hints[name], parameter.default, texts[name])
    return found


_REPORT = _find_options(CommandReport)


def _add_option(parser: argparse.ArgumentParser, name: str, option: CommandOption) -> None:
    hint, settings = option.type, dict[str, Any]()
    if hasattr(hint, "__metadata__"):
        settings, hint = dict(hint.__metadata__[0]), get_args(hint)[0]
    own = [part for part in get_args(hint) if part is not NoneType]
    if get_origin(hint) is Literal:
        settings["choices"] = own
    elif get_origin(hint) is list:
        settings |= {} if "action" in settings else {"nargs": "+"}
    hint = own[0] if own else hint
    positional = option.default is inspect.Parameter.empty
    if hint is bool:
        switch = argparse.BooleanOptionalAction if option.default else "store_true"
        settings["action"] = switch
    elif hint in (int, float, Path):
        settings["type"] = hint
    if not positional:
        settings["default"] = option.default
    if not positional and hint is not bool and "choices" not in settings:
        settings.setdefault("metavar", name.upper())
    flags = [name] if positional else ["-o", "--output"] if name == "output" else [_flag(name)]
    complete = settings.pop("complete", None)
    action = parser.add_argument(*flags, help=option.text.replace("%", "%%"), **settings)
    if complete:
        action.complete = complete  # type: ignore[attr-defined]  # shtab reads it


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
