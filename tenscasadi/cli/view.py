"""Command that shows scenes, motions and plans in a browser, or as a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.cli.loading import load_viewer
from tenscasadi.cli.output import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import find_source
from tenscasadi.integrators.stabilization import Projection


def run_view(arguments: argparse.Namespace) -> int:
    """Show things in a browser, write them as a page, or simulate in real time.

    Raises ValueError, OSError, ImportError.
    """
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
    look = {"color": arguments.color, "speed": arguments.speed, "follow": arguments.follow}
    load_viewer().view(things, html=arguments.html, **look, **where, wait=True)
    if arguments.html is not None:
        print(f"wrote {arguments.html}")
    return 0


def _live(arguments: argparse.Namespace, where: dict[str, Any]) -> int:
    if len(arguments.things) != 1 or arguments.html is not None:
        raise ValueError("live takes one scene, and writes no page: leave the rest out")
    if arguments.save is not None:
        check_file("save", arguments.save)
    source = find_source(arguments.things[0])
    simulation = source.simulation()
    viewer = load_viewer()
    options = viewer.LiveOptions(
        simulation.step, simulation.scheme, simulation.correction or Projection()
    )
    control = (
        None
        if callable(simulation.control) or np.ndim(simulation.control) != 1
        else simulation.control
    )
    viewer.live(
        simulation.model,
        state=simulation.start,
        control=control,
        groups=source.string_groups or None,
        options=options,
        save=arguments.save,
        title=source.stem,
        speed=arguments.speed,
        parameters=simulation.parameters,
        wait=True,
        **where,
    )
    return 0
