"""The command that shows scenes, motions and plans in a browser, or writes them as a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tenscasadi.cli.output import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import find_source


def run_view(arguments: argparse.Namespace) -> int:
    """Show what is named, over each other; or write the page. Raises ValueError, OSError, ImportError."""
    from tenscasadi.viewer.view import view  # only here: what needs no viewer does not wait for it

    if arguments.html is not None:
        check_file("html", arguments.html)
    things: dict[str, Any] = {}
    for name in arguments.things:
        label = Path(name).stem if Path(name).stem not in things else name
        things[label] = load_result(name) if name.endswith(".npz") else find_source(name).scene()
    look = {"colour": arguments.colour, "speed": arguments.speed, "follow": arguments.follow}
    where = {"host": arguments.host, "port": arguments.port, "browser": False if arguments.no_browser else None}
    view(things, html=arguments.html, **look, **where, wait=True)
    if arguments.html is not None:
        print(f"wrote {arguments.html}")
    return 0
