"""All phases as one program: each has its own unknowns, and begins where the one before it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.phases.contact import cone_blocks, height_blocks
from ocp.phases.motion import PhaseMotion
from ocp.transcription.assemble import asked_blocks
from ocp.transcription.sparse_nlp import Block, Program, Separable, Unknowns
from tenscasadi.scene.ground import Surface
from tenscasadi.util.validate import Array, Indices


class PhaseValues(NamedTuple):
    """A solution of a phase of s nodes that stand; the state before its impact, if it has one, is the end of the phase before.

    states (K + 1, nx); force_density (K, α), or (K + 1, α) where it is linear, N/m; duration, s;
    reactions (K + 1, s, 3), N; impulses of the impact (0 or 1, s, 3), N·s.
    """

    states: Array
    force_density: Array
    duration: float
    reactions: Array
    impulses: Array


@dataclass(frozen=True, eq=False)
class PhasedProgram:
    """The program of all phases; labels: for each phase, where its entries are among those of the program."""

    program: Program
    motions: tuple[PhaseMotion, ...]
    labels: tuple[Indices, ...]

    def values(self, w: Array) -> list[PhaseValues]:
        """Return the values of each phase that scaled unknowns stand for."""
        unknowns = self.program.parts.unknowns
        y = np.concatenate([unknowns.scale * w, unknowns.constants])
        return [
            _read(motion, y[label]) for motion, label in zip(self.motions, self.labels, strict=True)
        ]


def link_phases(
    motions: Sequence[PhaseMotion],
    grounds: Sequence[Surface],
    ends: Sequence[tuple[float, float] | None],
) -> PhasedProgram:
    """Return the program of phases one after another; ends: (earliest, latest) time of each phase's end, s, where it is limited."""
    numbering = _Numbering()
    rows, costs = [], []
    for k, motion in enumerate(motions):
        v = motion.v
        landing = motions[k + 1].stands if k + 1 < len(motions) else ()
        asked = asked_blocks(v)
        used = v.entries.used_by([*asked.rows, *asked.costs])
        own = motion.blocks(bool(used[v.states[1:-1, motion.nq : 2 * motion.nq]].any()))
        own += [
            *(cone_blocks(motion, grounds[0]) if motion.stands else ()),
            *height_blocks(motion, grounds, landing),
        ]
        numbering.add(
            *v.entries.ordered(),
            motion.begins,
            motions[k - 1].ends(motion.linked) if k else motion.begins,
        )
        rows.append(
            [
                replace(block, names=tuple(f"{name}, phase {k}" for name in block.names))
                for block in (*own, *asked.rows)
            ]
        )
        costs.append(asked.costs)
    unknowns, labels = numbering.finished()
    every, priced = (
        [
            block.relabelled(label)
            for label, blocks in zip(labels, parts, strict=True)
            for block in blocks
        ]
        for parts in (rows, costs)
    )
    every += _end_times(motions, labels, ends)
    return PhasedProgram(_program(motions, unknowns, labels, every, priced), tuple(motions), labels)


def _program(
    motions: Sequence[PhaseMotion],
    unknowns: Unknowns,
    labels: Sequence[Indices],
    rows: Sequence[Block],
    costs: Sequence[Block],
) -> Program:
    objective = sum(motion.v.objective for motion in motions)
    parts = Separable(unknowns, rows, costs, 1 / objective)
    lower, upper, scale = (
        np.concatenate(columns) for columns in zip(*(block.limits() for block in rows), strict=True)
    )
    return Program(
        parts,
        w_lower=unknowns.lower / unknowns.scale,
        w_upper=unknowns.upper / unknowns.scale,
        first=unknowns.first / unknowns.scale,
        lower=lower,
        upper=upper,
        scale=scale,
        objective=objective,
        unpack=ca.Function("unpack", [parts.w], [unknowns.entries(parts.w)]),
        states=np.concatenate(
            [label[motion.v.states] for motion, label in zip(motions, labels, strict=True)]
        ),
    )


def _end_times(
    motions: Sequence[PhaseMotion],
    labels: Sequence[Indices],
    ends: Sequence[tuple[float, float] | None],
) -> list[Block]:
    """Return the limits of when phases end: of the sums of durations; the first one's are those of its duration."""
    durations = [label[motion.v.duration] for motion, label in zip(motions, labels, strict=True)]
    blocks = []
    for k, until in enumerate(ends):
        if until is not None and k:
            z, size = ca.SX.sym("z", k + 1), sum(motion.v.scales.time for motion in motions)
            function, index = (
                ca.Function("end", [z], [ca.sum1(z) / size]),
                np.concatenate(durations[: k + 1])[None],
            )
            blocks.append(
                Block(
                    function,
                    index,
                    (f"end of phase {k}",),
                    until[0] / size,
                    until[1] / size,
                    size,
                    kind="path",
                )
            )
    return blocks


class _Numbering:
    """Numbers the entries of phase after phase; what a phase begins with keeps the numbers that it has at the end of the one before."""

    def __init__(self) -> None:
        self._parts: list[Unknowns] = []
        self._labels: list[
            Indices
        ] = []  # of unknowns from 0 upwards, of constants from −1 downwards
        self._unknowns = self._constants = 0
        self._interval = 0.0

    def add(self, unknowns: Unknowns, place: Indices, begins: Indices, ends: Indices) -> None:
        """Add the entries of a phase, of which `begins` are the entries `ends` of the one before."""
        own = np.arange(unknowns.count)
        number = np.concatenate([own, -1 - self._constants - np.arange(len(unknowns.constants))])
        if self._labels:
            number[place[begins]] = self._labels[-1][ends]
            own = np.setdiff1d(own, place[begins])
        number[own] = self._unknowns + np.arange(len(own))
        kept = unknowns.selected(own)
        last = np.max(
            kept.interval, where=np.isfinite(kept.interval), initial=0.0
        )  # the duration is of the phase alone
        self._parts.append(replace(kept, interval=self._interval + np.minimum(kept.interval, last)))
        self._labels.append(number[place])
        self._interval += last + 1
        self._unknowns += len(own)
        self._constants += len(unknowns.constants)

    def finished(self) -> tuple[Unknowns, tuple[Indices, ...]]:
        """Return all unknowns, and for each phase where its entries are among them and the constants."""
        fields = ("first", "scale", "lower", "upper", "interval", "constants")
        columns = {
            name: np.concatenate([getattr(part, name) for part in self._parts]) for name in fields
        }
        names = tuple(
            f"{name}, phase {k}" for k, part in enumerate(self._parts) for name in part.names
        )
        return Unknowns(names, **columns), tuple(
            np.where(label >= 0, label, self._unknowns - 1 - label) for label in self._labels
        )


def _read(motion: PhaseMotion, y: Array) -> PhaseValues:
    v, nq, feet = motion.v, motion.nq, len(motion.stands)
    states, duration = y[v.states], float(y[v.duration][0])
    states[1:-1, nq : 2 * nq] = (states[2:, :nq] - states[:-2, :nq]) / (
        duration * (v.fractions[1:] + v.fractions[:-1])
    )[:, None]
    reactions, impulses = (
        y[motion.reactions].reshape(v.count + 1, feet, 3),
        y[motion.impulses].reshape(int(motion.lands), feet, 3),
    )
    return PhaseValues(states, y[v.controls] @ v.group_matrix.T, duration, reactions, impulses)
