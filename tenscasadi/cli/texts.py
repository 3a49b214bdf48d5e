"""The commands that print text to go on with: a scene file to start from, and the JSON Schema of scene files."""

from __future__ import annotations

import argparse
import json

from tenscasadi.cli.loading import load_ocp
from tenscasadi.cli.source import SHAPES, STARTING_FILES


def run_new(arguments: argparse.Namespace) -> int:
    """Print a commented scene file. Raises ValueError."""
    if arguments.shape not in SHAPES:
        raise ValueError(f"unknown shape {arguments.shape!r}: give one of {', '.join(SHAPES)}")
    print((STARTING_FILES / f"{arguments.shape}.toml").read_text(encoding="utf-8"), end="")
    return 0


def run_schema(_: argparse.Namespace) -> int:
    """Print the JSON Schema of scene files."""
    schema = load_ocp().io.plan_section.file_schema()
    print(json.dumps(schema, indent=1, ensure_ascii=False))
    return 0
