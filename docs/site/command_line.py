"""The page of the command line: what `--help` says."""

from __future__ import annotations

import argparse
import os

from tenscasadi.cli.main import COMMANDS
from tenscasadi.cli.parser import command_parser


def command_line_page() -> str:
    """The page's Markdown: the help of the program and of each of its commands."""
    os.environ["COLUMNS"] = "80"  # which argparse reads
    parser = command_parser(COMMANDS)
    (commands,) = (
        action.choices
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    parts = ["# Command line", f"```text\n{parser.format_help()}```"]
    for name, command in commands.items():
        parts += [f"## {name}", f"```text\n{command.format_help()}```"]
    return "\n\n".join(parts)
