"""The command that prints a script with which a shell completes commands, options, shapes and files."""

from __future__ import annotations

import argparse

from tenscasadi.cli.source import SHAPES

# What the scripts complete, by shell: shapes and scene files, shapes, shapes and any file, folders.
SOURCE = {"bash": "_tenscasadi_scenes", "zsh": "_tenscasadi_scenes"}
SHAPE = {"bash": "_tenscasadi_shapes", "zsh": "_tenscasadi_shapes"}
FILE = {"bash": "_tenscasadi_files", "zsh": "_tenscasadi_files"}
FOLDER = {"bash": "_shtab_compgen_dirs", "zsh": "_files -/"}

_NAMES = " ".join(SHAPES)
_SCENES = {
    "bash": f"""
_tenscasadi_shapes() {{
  compgen -W "{_NAMES}" -- "$1"
}}
_tenscasadi_scenes() {{
  compgen -W "{_NAMES}" -- "$1"
  compgen -f -X '!*.toml' -- "$1"
  compgen -d -- "$1"
}}
_tenscasadi_files() {{
  compgen -W "{_NAMES}" -- "$1"
  compgen -f -- "$1"
}}
""",
    "zsh": f"""
_tenscasadi_shapes() {{
  compadd {_NAMES}
}}
_tenscasadi_scenes() {{
  compadd {_NAMES}
  _files -g '*.toml'
}}
_tenscasadi_files() {{
  compadd {_NAMES}
  _files
}}
""",
}


def run_completion(arguments: argparse.Namespace) -> int:
    """Print the script. Raises ImportError without shtab."""
    try:
        import shtab
    except ImportError:
        raise ImportError("completion needs shtab: pip install 'tenscasadi[completion]'") from None
    print(shtab.complete(arguments.parser, arguments.shell, preamble=_SCENES[arguments.shell]))
    return 0
