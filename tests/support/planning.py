"""Plans that many tests make: a free prism that grows, a pinned D-bar that folds, and the programs of such problems."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import ocp
import tenscasadi as tc
from ocp.guess.path import make_guess
from ocp.plan.plan_files import read_parts, write_parts
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.assemble import build_program
from tenscasadi.io.document import read_tables

BAR = 1.4
GROUPS = ((0, 1, 2), (3, 4, 5), (6, 7, 8))  # of the prism's strings, by its symmetry


def prism(height, **options):
    """The equilibrium prism of a height whose bars are BAR long."""
    return tc.shapes.prism(
        3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options
    )


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


def raising(**changes):
    """Build the problem of a prism that grows from 1.0 to 1.1 m, from rest to rest."""
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    given = {
        "model": driven(prism(1.0)),
        "goals": goals,
        "bounds": [ocp.ForceDensityLimits(5.0, 100.0)],
        "costs": [ocp.Effort()],
        **changes,
    }
    return ocp.Problem(**given)


def folding(**changes):
    """Class 2: a D-bar pinned at a node."""
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.6).string_lengths), ocp.AtRest()]
    return ocp.Problem(
        driven(tc.shapes.d_bar(pinned=[0])), goals=goals, costs=[ocp.Effort()], **changes
    )


def shaken(duration=1.0, *bounds):
    """A prism of which one foot is shaken and one is lifted raises its top."""
    (a, b, c), (d, e, f) = prism(1.0).nodes[:2].tolist()
    feet = {0: lambda t: (a + 0.03 * ca.sin(4 * t), b, c), 1: lambda t: (d, e, f + 0.02 * t**2)}
    model = driven(
        prism(1.0, pinned=[0, 1, 2]),
        supports=tc.SupportMotion(feet),
        gravity=tc.Gravity((0.0, 0.0, -2.0)),
    )
    goals = [ocp.NodePositions({5: (None, None, 1.05)}), ocp.NodeVelocities({4: (None, None, 0.0)})]
    bounds = [ocp.ForceDensityLimits(1.0, 100.0), *bounds]
    return ocp.Problem(
        model,
        duration,
        goals=goals,
        bounds=bounds,
        costs=[ocp.Effort(), *[ocp.Duration(5.0)] * isinstance(duration, tuple)],
    )


def program(problem, transcription):
    """The program that is solved, without the rows that no string moves left out."""
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    return build_program(
        transcription, problem, target, scales, make_guess(problem, target, transcription.count)
    )


def taller(*bounds):
    """The prism with stiff strings grows to 1.15 m as a whole, from rest to rest."""
    goals = [ocp.Shape(prism(1.15).nodes), ocp.AtRest()]
    model = driven(prism(1.0, stiffness=1000.0))
    return ocp.Problem(
        model,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(5.0, 100.0), *bounds],
        costs=[ocp.Effort()],
    )


def integrated(plan, share=1.0):
    """Integrate the planned force densities by SciPy up to a fraction of the duration."""
    model, state = plan.model, plan.trajectory.states[0]
    for begin, end, gamma in zip(plan.time, plan.time[1:], plan.force_density, strict=False):
        end = min(end, share * plan.time[-1])
        if end > begin:
            rate = lambda t, x, gamma=gamma: model.ode(x, gamma).full().ravel()  # noqa: E731
            state = solve_ivp(rate, (begin, end), state, "DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    return state


def leaning_arm(bars, lean, weight=False, duration=1.0):
    """Bars of 1 m on top of each other, hinged on the ground and to each other, each held by four strings: at first straight, its tip moves aside."""
    joints = [(0.0, 0.0, float(level)) for level in range(bars + 1)]
    around = [
        (x, y, float(level))
        for level in range(bars)
        for x, y in ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
    ]
    strings = [
        (level + 1, bars + 1 + 4 * level + side) for level in range(bars) for side in range(4)
    ]
    pinned = [0, *range(bars + 1, bars + 1 + 4 * bars)]
    structure = tc.Structure(
        [*joints, *around], [(k, k + 1) for k in range(bars)], strings, pinned=pinned
    )
    goals = [ocp.NodePositions({bars: (lean, 0.1, None)}), ocp.AtRest()]
    model = driven(structure, gravity=tc.Gravity() if weight else None)
    return ocp.Problem(
        model,
        duration,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 300.0)],
        costs=[ocp.Effort()],
    )


def save_and_load(**parts):
    """Model, problem and method of solution from the text that the file of a plan holds for them."""
    given = dict.fromkeys(("problem", "transcription", "solver")) | {"not_restored": "none"} | parts
    plan = SimpleNamespace(structure=parts["model"].structure, **given)
    return read_tables("plan", write_parts(plan), read_parts)
