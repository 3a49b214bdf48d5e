"""Events within fixed steps, or steps that lose energy, and how far they put a run off: a piece of it taken again, in steps half as long."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_switching, count_switches
from tenscasadi.integrators.scheme import extent
from tenscasadi.simulation.control_input import SampledControl
from tenscasadi.simulation.steppers import LoopStepper, StepFailure, Stepper
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array

_FEWEST, _SHARE = 200, 60  # steps of the piece, at least, and as a part of the run: it is taken three times
_LOOKS = 100  # kept rows at which contacts are looked for
_SPOKEN = 0.01  # of the motion: what the message speaks of
_LOST = 1e-3  # of the energy that moves: steps that lose more are looked at without events, too
_ROUNDING = 1e-9  # of the structure's size
_FINER = 0.25  # of the step, as a cure: errors at events fall about like the step


def describe_missed_events(model: Model, stepper: Stepper, inputs: SampledControl, rows: Array, run: Trajectory) -> str:
    """Say how far events within the steps put a run off that finished, where that shows, and the cure; "" where it does not.

    Steps that do not end where strings go slack or taut and where nodes meet or leave a ground lose their order there. A piece of the run
    from the first such event that shows on is taken again, in its own steps and in halves of these, with the control held: as far as these
    two come apart, the run is off after as long a time, and errors grow with time. Where energy is lost
    to the steps, with events or without, the piece begins where most is; near the end of a run, a piece before it. rows (R, nz): z at the kept times.
    """
    if not isinstance(stepper, LoopStepper):
        return ""
    changed, lost = _first_change(model, run), _loses_energy(run)
    if changed is None and not lost:
        return ""
    row = int(np.abs(np.diff(run.energy_error)).argmax()) if changed is None or lost else changed
    count = min(max(_FEWEST, inputs.steps // _SHARE), inputs.steps)
    starts = inputs.times(np.arange(inputs.steps))
    latest = int(np.searchsorted(run.time, starts[inputs.steps - count], "right")) - 1  # that a whole piece is left
    row = max(0, min(row, latest))
    first = int(np.argmin(np.abs(starts - run.time[row])))
    held, lengths = np.append(run.control[row], run.parameters), inputs.lengths(first, count)
    try:
        whole = _march(stepper, rows[row], held, lengths)
        halves = _march(stepper, rows[row], held, np.repeat(lengths / 2, 2))[1::2]
    except StepFailure:
        return ""
    apart = float(np.linalg.norm(model.nodes(whole[:, : model.nx]) - model.nodes(halves[:, : model.nx]), axis=2).max())
    off = apart * float((run.time[-1] - run.time[row]) / lengths.sum())
    if not off > max(_SPOKEN * float(np.ptp(run.nodes, axis=0).max()), _ROUNDING * extent(model)):  # NaN: not known
        return ""
    if changed is None:
        return f"; its steps, too long for the fastest that moves, put it off by some {off:.1g} m: try step={_FINER * run.step:.2g}"
    events = "strings that go slack or taut" + (" and contacts" if model.scene.grounds else "")
    return (
        f"; {events} within its steps put it off by some {off:.1g} m: "
        f"try DormandPrince853(rtol=1e-6), which ends its steps there, or step={_FINER * run.step:.2g}"
    )


def _loses_energy(run: Trajectory) -> bool:
    """Return whether more energy is off than steps leave that follow the motion."""
    parts = run.energy_parts
    moved = float(parts[:, 0].max() + np.ptp(parts[:, 1:], axis=0).sum())
    return bool(np.abs(run.energy_error).max() > _LOST * moved)  # NaN: not known


def _first_change(model: Model, run: Trajectory) -> int | None:
    """Return the kept row after which another string pulls, or another node touches a ground, for the first time; None: there is none."""
    rows = np.arange(len(run.time))
    modes: Any = run.tension[:, model.scene.switching_strings] != 0
    if model.scene.grounds and any(count_switches(model)):
        key = ("switching",)
        if key not in model.functions:
            model.functions[key] = build_switching(model) or ca.Function()
        rows = np.unique(np.linspace(0, rows[-1], min(len(rows), _LOOKS)).astype(np.intp))
        held = np.hstack([run.control[rows], np.tile(run.parameters, (len(rows), 1))])
        modes = model.functions[key].map(len(rows))(run.states[rows].T, ca.DM(held.T)).full().T > 0
    changes = np.flatnonzero((modes[1:] != modes[:-1]).any(axis=1))
    return int(rows[changes[0]]) if len(changes) else None


def _march(stepper: Stepper, z: Array, held: Array, lengths: Array) -> Array:
    """Return z after each of the steps of these lengths (k,), s, with the input held (nw,)."""
    found = []
    for begin in range(0, len(lengths), stepper.steps):
        own = lengths[begin : begin + stepper.steps]
        stepper.hold(np.tile(held, (stepper.steps + 1, 1)), np.resize(own, stepper.steps))
        found.append(stepper(z, len(own))[: len(own)].copy())
        z = found[-1][-1]
    return np.concatenate(found)
