"""The command that prints a scene file to start from."""

from __future__ import annotations

import argparse

from tenscasadi.cli.source import SHAPES, STARTING_FILES


def run_new(arguments: argparse.Namespace) -> int:
    """Print a commented scene file. Raises ValueError."""
    if arguments.shape not in SHAPES:
        raise ValueError(f"unknown shape {arguments.shape!r}: give one of {', '.join(SHAPES)}")
    print((STARTING_FILES / f"{arguments.shape}.toml").read_text(encoding="utf-8"), end="")
    return 0
