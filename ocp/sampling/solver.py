"""Solver `Sampling` and its options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from ocp.problem.reading import read_groups
from ocp.solvers.base import NamedSolver
from tenscasadi.schema.field_types import InPython, ListOf, Members
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import MAX_ENTRIES, Boolean, IndexOrName, of_type, whole


@rename_fields(watch="callback")
@dataclass(frozen=True)
class Sampling(NamedSolver, kind="Sampling"):
    """Random search on simulated motions, then Gauss-Newton.

    Use it for plans with contact, where derivatives are of little use. The plan satisfies
    goals and limits; its cost is low, but not optimal.

    Parameters
    ----------
    groups : sequence of sequences of int or str, optional
        Groups of strings that change together. Strings in no group do not change. Default: strings
        of equal length whose ends have equal heights at the start; then single strings, if these
        groups do not reach the goals.
    knots : int, optional
        Number of spline knots between two waypoints. Default: three in the time of a free fall over
        the structure's size, from 6 to 24.
    samples : int
        Motions in each round. Up to 8 are simulated at once in SIMD lanes.
    seed : int
        Seed of the samples. The plan does not depend on the number of threads.
    rounds : int
        Largest number of rounds between two waypoints.
    iterations : int
        Largest number of iterations of Gauss-Newton.
    attempts : int
        Number of attempts, with new samples each, until the goals are met.
    threads : int, optional
        Number of threads. Default: one for each processor that this process may use.
    verbose : bool
        Whether to print a line for each round and iteration.
    callback : callable, optional
        Function that receives a line of text after each round and iteration. The search stops if it
        returns False. The plan is then the best so far, as after Ctrl-C.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or a string does not exist.

    Notes
    -----
    Splines through random knots change the force densities. The best sample is kept, and the next
    samples are drawn about it with less spread. In these simulations, strings are elastic and
    damped, because constant force densities may let a shape collapse. The plan contains the
    resulting force densities. Gauss-Newton then removes the residuals of goals and limits. Its
    derivatives are finite differences over single intervals. Its trial motions have feedback, which
    computes the step anew from the state at each interval.

    Without a C++ compiler, motions are simulated one by one, more slowly, and `Plan.status` reports
    it.

    Examples
    --------
    A prism jumps, and its center of mass rises by 20 cm.

    >>> import ocp
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(bar_mass=0.3)
    >>> ground = tc.Ground(stiffness=1e4, damping=20.0, friction=0.6, slip_speed=0.01)
    >>> model = tc.Model(tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground))
    >>> goal = ocp.CenterOfMass((None, None, prism.nodes[:, 2].mean() + 0.2))
    >>> plan = ocp.solve(ocp.Problem(model, 0.5, goals=[goal], bounds=[ocp.ForceDensityLimits(5.0, 500.0)]), solver=ocp.Sampling(samples=64))
    >>> plan.success
    True
    """

    groups: Annotated[Iterable[Sequence[IndexOrName]] | None, ListOf(Members("input"))] = None
    knots: Annotated[int | None, whole(1, 1000)] = None
    samples: Annotated[int, whole(8, MAX_ENTRIES)] = 256
    seed: Annotated[int, whole(0, MAX_ENTRIES)] = 0
    rounds: Annotated[int, whole(1, MAX_ENTRIES)] = 40
    iterations: Annotated[int, whole(0, MAX_ENTRIES)] = 40
    attempts: Annotated[int, whole(1, MAX_ENTRIES)] = 8
    threads: Annotated[int | None, whole(1, 1024)] = None
    verbose: Boolean = False
    callback: Annotated[
        Callable[[str], Any] | None,
        InPython(),
        of_type(Callable, "a function of a line of text, or None"),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.groups is not None:
            groups = read_groups("Sampling.groups", self.groups, strict=True)
            object.__setattr__(self, "groups", groups)
