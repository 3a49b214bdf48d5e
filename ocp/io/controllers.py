"""Controllers in the table [closed_loop] of scene files."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any

from ocp.control.closed_loop import Controller
from ocp.control.lqr import track
from ocp.control.mpc import Mpc
from ocp.control.mppi import Mppi
from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from tenscasadi.schema.field_types import PER_ITEM
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Boolean


class ControllerOptions(Value, implied="Mpc"):
    """Base class of controllers in scene files.

    `build` creates the controller from its options.
    """

    @property
    def needs_plan(self) -> bool:
        """Whether the controller tracks a plan."""
        return False

    @abstractmethod
    def build(self, problem: Problem, plan: PlanResult | None) -> Controller:
        """Build the controller.

        `plan` is None unless `needs_plan`. Raises TypeError, ValueError.
        """


@dataclass(frozen=True)
class MpcOptions(ControllerOptions, kind="Mpc"):
    """Model predictive control, see `ocp.Mpc`.

    Parameters
    ----------
    period : float
        Sampling period [s].
    intervals : int
        Prediction horizon in periods.
    along_plan : bool
        Whether to solve the problem first, and to track its plan. Otherwise the controller tracks
        the state of the goals.
    iterations : int
        Quadratic programs for each decision.
    substeps : int
        Number of steps of RungeKutta4 in each period.
    position_scale : float
        Deviation of a coordinate [m] that costs as much as a control deviation of `control_scale`.
        Default: 1 % of the structure's size.
    control_scale : float
        Deviation of a force density [N/m]. Default: the mean of the plan or of the goals.
    """

    period: float = 0.05
    intervals: int = 10
    along_plan: Boolean = False
    iterations: int = 1
    substeps: int = 1
    position_scale: float | None = None
    control_scale: float | None = None

    @property
    def needs_plan(self) -> bool:
        """Whether the controller tracks a plan."""
        return self.along_plan

    def build(self, problem: Problem, plan: PlanResult | None) -> Controller:
        """Build the controller; see `ControllerOptions.build`."""
        options = dict(self.to_fields())
        del options["along_plan"]
        return Mpc(problem, plan=plan, **options)


@dataclass(frozen=True)
class MppiOptions(ControllerOptions, kind="Mppi"):
    """Model predictive path integral control, see `ocp.Mppi`.

    Parameters
    ----------
    period : float
        Sampling period [s].
    horizon : float
        Prediction horizon [s].
    samples : int
        Motions in each iteration.
    noise : float or array_like, shape (α,)
        Standard deviation of the force densities [N/m]. Default: a tenth of the distance between
        their limits.
    initial : float or array_like, shape (α,)
        Initial force densities [N/m]. Default: those that hold the start best.
    temperature : float
        Temperature of the weights. Towards 0, only the best motion counts.
    iterations : int
        Iterations for each decision.
    steps : int
        Number of steps of RungeKutta4 in each period.
    position_scale : float
        Distance from a goal that costs 1 [m]. Default: 1 % of the structure's size.
    seed : int
        Seed of the noise.
    """

    period: float = 0.05
    horizon: float = 0.5
    samples: int = 64
    noise: Annotated[Any, PER_ITEM] = None
    initial: Annotated[Any, PER_ITEM] = None
    temperature: float = 0.1
    iterations: int = 1
    steps: int = 10
    position_scale: float | None = None
    seed: int = 0

    def build(self, problem: Problem, plan: PlanResult | None) -> Controller:
        """Build the controller; see `ControllerOptions.build`."""
        return Mppi(problem, **self.to_fields())


@dataclass(frozen=True)
class TrackOptions(ControllerOptions, kind="Track"):
    """Time-varying LQR along the plan of the problem, see `ocp.track`.

    The run should end with the plan, after which there is nothing to track.

    Parameters
    ----------
    decisions : int
        Number of decisions, at equal times. Default: one per interval of the plan, as long as the
        shortest.
    position_scale : float
        Deviation of a coordinate [m] that costs as much as a control deviation of `control_scale`.
        Default: 1 % of the structure's size.
    control_scale : float
        Deviation of a force density [N/m]. Default: a tenth of the plan's mean.
    """

    decisions: int | None = None
    position_scale: float | None = None
    control_scale: float | None = None

    @property
    def needs_plan(self) -> bool:
        """Whether the controller tracks a plan."""
        return True

    def build(self, problem: Problem, plan: PlanResult | None) -> Controller:
        """Build the controller; see `ControllerOptions.build`."""
        if plan is None:
            raise ValueError("plan is None: give the plan to track")
        return track(plan, **self.to_fields())
