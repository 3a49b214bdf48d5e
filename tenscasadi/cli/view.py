"""Command `view`: scenes and results in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from tenscasadi.cli.loading import load_viewer
from tenscasadi.cli.report import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import FILE, SceneSource, find_source
from tenscasadi.integrators.stabilization import Projection

_PAGE = {**FILE, "metavar": "OUT"}


def show(
    things: Annotated[list[str], {**FILE, "nargs": "+"}],
    html: Annotated[Path | None, _PAGE] = None,
    live: bool = False,
    save: Annotated[Path | None, _PAGE] = None,
    host: str = "127.0.0.1",
    port: int | None = None,
    no_browser: bool = False,
    color: Literal["tension", "force density"] = "tension",
    speed: float = 1.0,
    follow: bool = False,
    side_by_side: bool = False,
) -> int:
    """Show scenes, trajectories and plans in a browser.

    With --html it writes a page instead. Several trajectories are superimposed, the first one
    opaque. Ctrl-C ends the viewer.

    Parameters
    ----------
    things : list of str
        Templates, scene files (.toml, .json), trajectories, rollouts, plans (.npz).
    html : Path
        Write one page that plays in any browser, instead of showing it now.
    live : bool
        Simulate in real time: sliders for the strings, nodes to pull at.
    save : Path
        With --live: the file that the button Save writes (.npz).
    host : str
        Address to listen on (default: 127.0.0.1, this machine alone).
    port : int
        Port (default: one that is free).
    no_browser : bool
        Open no browser: print the address.
    color : str
        Quantity that the color of strings shows (default: tension).
    speed : float
        Simulated seconds per second (default: 1).
    follow : bool
        Keep the first motion in the middle.
    side_by_side : bool
        Show several motions beside each other.
    """
    where = {"host": host, "port": port, "browser": False if no_browser else None, "wait": True}
    if live:
        if len(things) != 1 or html is not None:
            raise ValueError("live takes one scene, and writes no page: leave the rest out")
        if save is not None:
            check_file("save", save)
        _simulate_live(find_source(things[0]), save=save, speed=speed, **where)
        return 0
    if save is not None:
        raise ValueError(f"save is {save}: it is for --live, give --html to write a page")
    if html is not None:
        check_file("html", html)
    found: dict[str, Any] = {}
    for name in things:
        label = Path(name).stem if Path(name).stem not in found else name
        found[label] = load_result(name) if name.endswith(".npz") else find_source(name).scene()
    load_viewer().view(
        found,
        html=html,
        color=color,
        speed=speed,
        follow=follow,
        side_by_side=side_by_side,
        **where,
    )
    if html is not None:
        print(f"wrote {html}")
    return 0


def _simulate_live(source: SceneSource, **options: Any) -> None:
    viewer, simulation = load_viewer(), source.simulation()
    correction = simulation.correction or Projection()
    control = simulation.control
    viewer.live(
        simulation.model,
        state=simulation.start,
        control=None if callable(control) or np.ndim(control) != 1 else control,
        groups=source.string_groups or None,
        options=viewer.LiveOptions(simulation.step, simulation.scheme, correction),
        title=source.stem,
        parameters=simulation.parameters,
        **options,
    )
