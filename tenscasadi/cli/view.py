"""The command that shows scenes, motions and plans in a browser, or writes them as a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.cli.output import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import find_source
from tenscasadi.integrators.stabilization import Projection


def run_view(arguments: argparse.Namespace) -> int:
    """Show what is named, over each other; or write the page; or simulate in real time. Raises ValueError, OSError, ImportError."""
    from tenscasadi.viewer.view import view  # only here: what needs no viewer does not wait for it

    where = {
        "host": arguments.host,
        "port": arguments.port,
        "browser": False if arguments.no_browser else None,
    }
    if arguments.live:
        return _live(arguments, where)
    if arguments.save is not None:
        raise ValueError(f"save is {arguments.save}: it is for --live, give --html to write a page")
    if arguments.html is not None:
        check_file("html", arguments.html)
    things: dict[str, Any] = {}
    for name in arguments.things:
        label = Path(name).stem if Path(name).stem not in things else name
        things[label] = load_result(name) if name.endswith(".npz") else find_source(name).scene()
    look = {"colour": arguments.colour, "speed": arguments.speed, "follow": arguments.follow}
    view(things, html=arguments.html, **look, **where, wait=True)
    if arguments.html is not None:
        print(f"wrote {arguments.html}")
    return 0


def _live(arguments: argparse.Namespace, where: dict[str, Any]) -> int:
    from tenscasadi.viewer.live_mode.live import live
    from tenscasadi.viewer.live_mode.simulation import Stepping

    if len(arguments.things) != 1 or arguments.html is not None:
        raise ValueError("live takes one scene, and writes no page: leave the rest out")
    if arguments.save is not None:
        check_file("save", arguments.save)
    source = find_source(arguments.things[0])
    simulation = source.simulation()
    stepping = Stepping(simulation.step, simulation.scheme, simulation.correction or Projection())
    control = (
        None
        if callable(simulation.control) or np.ndim(simulation.control) != 1
        else simulation.control
    )
    live(
        simulation.model,
        state=simulation.start,
        control=control,
        groups=source.string_groups or None,
        stepping=stepping,
        save=arguments.save,
        title=source.stem,
        speed=arguments.speed,
        parameters=simulation.parameters,
        wait=True,
        **where,
    )
    return 0
