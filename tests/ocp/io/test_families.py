"""Every goal, bound, cost and way to solve that the package offers is in its family, with forms and texts."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import pytest

import ocp
import tenscasadi as tc
from ocp.guess.initial_guess import NamedGuess
from ocp.io.controllers import ControllerOptions
from ocp.problem.bounds.bound import Bound
from ocp.problem.costs import Cost
from ocp.problem.goals.goal import Goal
from ocp.problem.phase import Phase
from ocp.problem.problem import FreeStart
from ocp.solvers.base import NamedSolver
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import NamedProfile
from tenscasadi.integrators.scheme import NamedScheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.scene.control import Control
from tenscasadi.scene.ground import Surface
from tenscasadi.scene.over_time import OverTime
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.strings import StringLaw
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.schema.definitions import OneOf

OWN = {
    "Constraint",
    "Integral",
    "AtEnd",
}  # expressions in Python: no file holds them
PLANNED = [
    Goal,
    Bound,
    Cost,
    Phase,
    FreeStart,
    Transcription,
    NamedProfile,
    NamedSolver,
    NamedGuess,
]
SIMULATED = [
    *(NamedScheme, Correction, Surface, OverTime, SupportMotion, Parameters),
    *(Control, StringLaw),
]
MEMBERS = {
    f"{family.__name__}.{kind}": own
    for family in (*PLANNED, *SIMULATED, ControllerOptions)
    for kind, own in OneOf(family).definitions.items()
}


@pytest.mark.parametrize("family", [Goal, Bound, Cost, Transcription])
def test_public_classes_are_members(family: type[Any]) -> None:
    public = {name: getattr(ocp, name) for name in ocp.__all__}
    wanted = {
        name
        for name, value in public.items()
        if inspect.isclass(value) and issubclass(value, family) and name not in OWN
    }
    # soft goals are costs, too, and files hold them among the goals
    assert wanted - ({"SoftGoal"} if family is Cost else set()) <= set(family.members)


@pytest.mark.parametrize("family", PLANNED + SIMULATED)
def test_members_are_public(family: type[Any]) -> None:
    assert set(family.members) <= {*ocp.__all__, *tc.__all__}


def test_solvers_and_guesses_are_members() -> None:
    assert set(NamedSolver.members) == {"Ipopt", "CondensedNewton", "Sampling"}
    assert set(NamedGuess.members) == {"InverseDynamics", "EquilibriumGuess", "TrajectoryGuess"}


@pytest.mark.parametrize("name", MEMBERS)
def test_every_field_has_a_type_and_a_text(name: str) -> None:
    own = MEMBERS[name]
    given = (
        {field.name for field in dataclasses.fields(own.build)}
        if dataclasses.is_dataclass(own.build)
        else set(inspect.signature(own.build).parameters)
    )
    assert given == set(own.fields)
    assert all(field.text for field in own.fields.values())  # editors show it
