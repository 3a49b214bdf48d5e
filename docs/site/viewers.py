"""Motions of the gallery as pages that play in a browser."""

from __future__ import annotations

import contextlib
import io
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import tenscasadi as tc
from tenscasadi.viewer import view

EXAMPLES = str(Path(__file__).resolve().parents[2] / "examples")
FROM_MAIN = (
    "plan_prism",
    "dbar_folds",
    "plan_landing",
    "swing_up",
    "catch_prism",
    "ball_on_terrain",
    "arm_reaches",
)  # examples whose result is worth watching


@cache
def viewer_pages() -> dict[str, str]:
    """The pages' HTML by path."""
    if EXAMPLES not in sys.path:
        sys.path.append(EXAMPLES)
    return {
        f"viewer/{name}.html": _page(thing) for name, thing in {**_results(), **_motions()}.items()
    }


def _page(thing: Any) -> str:
    with TemporaryDirectory() as folder:
        target = Path(folder, "page.html")
        run, ground = thing if isinstance(thing, tuple) else (thing, None)
        view(run, ground=ground, html=target)
        return target.read_text(encoding="utf-8")


def _results() -> dict[str, Any]:
    """What the examples return: plans, and a motion with its ground."""
    results = {}
    for name in FROM_MAIN:
        with TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            results[name] = __import__(name).main(folder=Path(folder))
    field, run = results["ball_on_terrain"]
    return {
        **results,
        "ball_on_terrain": (run, field),
        "arm_reaches": results["arm_reaches"]["round the ball"],
    }


def _motions() -> dict[str, Any]:
    """Motions whose examples return something else."""
    import double_pendulum
    import paper_dbar
    import paper_lander
    import paper_membrane

    ball = tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0)
    thrown = tc.Model(tc.Scene(ball, gravity=tc.Gravity()))
    start = thrown.state(ball.nodes, np.cross((1.0, 3.0, 0.5), ball.nodes) + (3.0, 0.0, 5.0))
    rods = tc.shapes.double_pendulum(angles=double_pendulum.ANGLES)
    return {
        "simulate_ball": tc.simulate(thrown, 1.0, 1e-3, state=start),
        "double_pendulum": tc.simulate(
            tc.Model(tc.Scene(rods, gravity=tc.Gravity())), 3.0, 1e-3, correction=tc.Projection()
        ),
        "paper_dbar": tc.simulate(
            tc.Model(tc.Scene(paper_dbar.d_bar())),
            5.0,
            1e-3,
            correction=tc.Projection(),
            compiled=False,
        ),
        "paper_lander": (paper_lander.drop(paper_lander.ball(), 3.0)[0], tc.Ground()),
        "paper_membrane": paper_membrane.run(8, 5),
    }
