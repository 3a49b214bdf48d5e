"""Sampling as a value: groups of strings, knots, samples, seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from ocp.sampling.spline_noise import SplineNoise
from ocp.solvers.base import NamedSolver
from tenscasadi.schema.containers import ListOf
from tenscasadi.schema.field_types import InPython, Members
from tenscasadi.util.validate import flag, format_value, whole_number

MOST = 1_000_000


@dataclass(frozen=True)
class Sampling(NamedSolver, kind="Sampling"):
    """Random search on simulated motions, then Gauss-Newton on the best: for motions through contact, where derivatives mislead.

    Splines through random knots change the force densities of few groups of strings; the best
    sample is kept, and the next ones are drawn about it, with less and less spread. Strings answer
    as elastic, damped ones would, which keeps shapes that constant force densities let collapse;
    the force densities that come of it are the plan. Gauss-Newton then removes the last misses:
    derivatives are finite differences of motions that are simulated side by side. Goals and
    waypoints are met, bounds kept; costs are low, but not least.

    Parameters
    ----------
    groups : sequence of sequences of int, optional
        Strings that change together; those in no group change with none. Default: strings of one
        length whose ends are equally high at the start; where these do not lead to the goals, each
        string for itself.
    knots : int, optional
        Knots of the splines between two waypoints. Default: as the duration asks for.
    samples : int
        Motions in each round, of which 8 are simulated at once where the processor can.
    seed : int
        Seed of the samples: the same seed finds the same plan, on any number of threads.
    rounds : int
        Most rounds between two waypoints.
    iterations : int
        Most iterations of Gauss-Newton.
    attempts : int
        How often all of it is tried, with other samples, until the goals are met.
    threads : int, optional
        Threads that share the motions. Default: one for each processor that this process may use.
    verbose : bool
        Whether to print a line for each round and iteration.
    watch : callable, optional
        Function of such a line. When it returns False the search stops; as after Ctrl-C, the plan
        is the best so far.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind; with a problem, if a string does not exist.

    Notes
    -----
    Without a compiler of C++ the motions are simulated one by one, more slowly; `Plan.status` then
    says so.

    Examples
    --------
    A prism jumps: its centre of mass rises by 20 cm.

    >>> import ocp
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(bar_mass=0.3)
    >>> ground = tc.Ground(stiffness=1e4, damping=20.0, friction=0.6, slip_speed=0.01)
    >>> model = tc.Model(tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground))
    >>> goal = ocp.CentreOfMass((None, None, prism.nodes[:, 2].mean() + 0.2))
    >>> plan = ocp.solve(ocp.Problem(model, 0.5, goals=[goal], bounds=[ocp.ForceDensityLimits(5.0, 500.0)]), solver=ocp.Sampling(samples=64))
    >>> plan.success
    True
    """

    groups: Annotated[Iterable[Sequence[int]] | None, ListOf(Members("string"))] = None
    knots: int | None = None
    samples: int = 256
    seed: int = 0
    rounds: int = 40
    iterations: int = 40
    attempts: int = 8
    threads: int | None = None
    verbose: bool = False
    watch: Annotated[Callable[[str], Any] | None, InPython()] = None

    def __post_init__(self) -> None:
        if self.groups is not None:
            object.__setattr__(self, "groups", read_groups("Sampling.groups", self.groups))
        for name, least in {
            "samples": 8,
            "seed": 0,
            "rounds": 1,
            "iterations": 0,
            "attempts": 1,
        }.items():
            object.__setattr__(
                self, name, whole_number(f"Sampling.{name}", getattr(self, name), least, MOST)
            )
        for name, most in {"knots": 1000, "threads": 1024}.items():
            if getattr(self, name) is not None:
                object.__setattr__(
                    self, name, whole_number(f"Sampling.{name}", getattr(self, name), 1, most)
                )
        flag("Sampling.verbose", self.verbose)
        if self.watch is not None and not callable(self.watch):
            raise TypeError(
                f"Sampling.watch is {format_value(self.watch)}: give a function of a line of text, or None"
            )


def read_groups(field: str, groups: Any) -> tuple[tuple[int, ...], ...]:
    """Return groups of strings, checked. Raises TypeError, ValueError."""
    try:
        return tuple(map(tuple, SplineNoise(1.0, groups=groups).groups or ()))
    except (TypeError, ValueError) as error:
        raise type(error)(str(error).replace("SplineNoise.groups", field)) from None
