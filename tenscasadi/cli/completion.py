"""The command that prints a script with which a shell completes commands, options, shapes and files."""

from __future__ import annotations

import argparse

from tenscasadi.cli.demos import DEMOS

# What the scripts complete, by shell: shapes and scene files, any file, folders.
SOURCE = {"bash": "_tenscasadi_scenes", "zsh": "_tenscasadi_scenes"}
FILE = {"bash": "_shtab_compgen_files", "zsh": "_files"}
FOLDER = {"bash": "_shtab_compgen_dirs", "zsh": "_files -/"}

_NAMES = " ".join(DEMOS)
_SCENES = {
    "bash": f"""
_tenscasadi_scenes() {{
  compgen -W "{_NAMES}" -- "$1"
  compgen -f -X '!*.toml' -- "$1"
  compgen -d -- "$1"
}}
""",
    "zsh": f"""
_tenscasadi_scenes() {{
  compadd {_NAMES}
  _files -g '*.toml'
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
