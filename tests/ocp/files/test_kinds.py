"""The table of definitions knows every goal, bound, cost and way to solve that the package offers."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import pytest

import ocp
from ocp.files import kinds
from ocp.problem.bounds.bound import Bound
from ocp.problem.costs import Cost
from ocp.problem.goals.goal import Goal
from ocp.transcription.base import Transcription

FUNCTIONS = {"Constraint", "Integral", "AtEnd"}  # expressions in Python: no file holds them
NOT_IN_FILES = {"watch"}  # fields that are functions
LISTS = {Goal: kinds.GOALS, Bound: kinds.BOUNDS, Cost: kinds.COSTS}


def offered(kind: type) -> dict[str, Any]:
    """The public classes of a kind by name."""
    public = {name: getattr(ocp, name) for name in ocp.__all__}
    return {
        name: value
        for name, value in public.items()
        if inspect.isclass(value) and issubclass(value, kind) and name not in FUNCTIONS
    }


def defined(form: Any) -> dict[str, Any]:
    kind = getattr(form, "form", form)
    return {definition.kind: definition for definition in kind.definitions}


@pytest.mark.parametrize("kind", LISTS, ids=lambda kind: kind.__name__)
def test_all_are_defined(kind):
    wanted = set(offered(kind)) - (
        {"SoftGoal"} if kind is Cost else set()
    )  # which is among the goals
    assert wanted <= set(defined(LISTS[kind]))


def test_all_ways_to_solve_are_defined():
    assert set(offered(Transcription)) == set(defined(kinds.TRANSCRIPTION))
    assert set(defined(kinds.SOLVER)) == {"Ipopt", "CondensedNewton", "Fatrop", "Sampling"}
    assert set(defined(kinds.GUESS)) == {"InverseDynamics", "Equilibrium", "Arrays"}


FORMS = [*LISTS.values(), kinds.TRANSCRIPTION, kinds.SOLVER, kinds.GUESS, kinds.PHASES]


@pytest.mark.parametrize(
    "definition",
    [each for form in FORMS for each in defined(form).values()],
    ids=lambda each: each.kind,
)
def test_every_field_is_defined(definition):
    if dataclasses.is_dataclass(definition.build):
        fields = {field.name for field in dataclasses.fields(definition.build)} - NOT_IN_FILES
        assert set(definition.fields) == fields
    else:
        assert set(definition.fields) == set(inspect.signature(definition.build).parameters)
    assert set(definition.texts) == set(definition.fields)  # what editors show
