"""Odd input to every public name: a TypeError, a ValueError or an exception of the packages that names a field, or a result without NaN."""

from __future__ import annotations

import faulthandler
import inspect
import os
import re
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from costly_calls import costly_calls
from ensemble_calls import ensemble_calls
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from odd_values import altered, list_odd
from public_calls import Call, quick_calls

import ocp
import tenscasadi as tc

OWN = (
    TypeError,
    ValueError,
    tc.CompileError,
    tc.EquilibriumError,
    tc.NoReferenceError,
    tc.NoSchemeError,
    ocp.InfeasibleGoalError,
)
NUMBER_OF_CALLS = int(os.environ.get("TENSCASADI_FUZZ", "10000"))  # of the slow run
LONGEST = 15  # s a call


def finite(result: Any) -> bool:
    """No NaN in a result that says success."""
    if isinstance(result, ocp.Plan):
        return not result.success or (
            finite(result.trajectory)
            and np.isfinite(result.force_density).all()
            and np.isfinite(result.objective)
        )
    if isinstance(result, tc.Trajectory):
        values = (
            result.time,
            result.nodes,
            result.velocities,
            result.tension,
            result.energy,
            result.states,
        )
        return not result.success or all(np.isfinite(value).all() for value in values)
    if isinstance(result, tc.Rollouts):
        return bool(
            np.isfinite(result.final[result.success]).all()
            and np.isfinite(result.energy_error[result.success]).all()
        )
    return True


class TooSlow(BaseException):
    """Raised for a call that hangs."""


@contextmanager
def limited(name: str) -> Iterator[None]:
    """Interrupt a call that takes too long, as Ctrl-C does; where it hangs in foreign code, the whole process ends and says where."""
    rung = []

    def stop(*_: Any) -> None:
        rung.append(True)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, stop) if hasattr(signal, "SIGALRM") else None
    faulthandler.dump_traceback_later(2 * LONGEST, exit=True)
    try:
        if before is not None:
            signal.alarm(LONGEST)
        yield
    except KeyboardInterrupt as error:
        if not rung:
            raise
        raise TooSlow(f"{name} takes more than {LONGEST} s") from error
    finally:
        faulthandler.cancel_dump_traceback_later()
        if before is not None:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)


def draw_fault(draw: Callable[[Any], Any], calls: dict[str, Call]) -> str:
    """Call one public name with one or two odd arguments; describe the fault, "" for none."""
    name = draw(st.sampled_from(sorted(calls)))
    right = calls[name][1]
    fields = draw(st.lists(st.sampled_from(sorted(right)), min_size=1, max_size=2, unique=True))
    return find_fault(name, calls[name], {field: altered(draw, right[field]) for field in fields})


def find_fault(name: str, call: Call, odd: dict[str, Any]) -> str:
    """Call a public name with these arguments odd; describe the fault, "" for none."""
    function, right = call
    changed = {**right, **odd}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with limited(name):
                result = function(**changed)
        except OWN as error:
            path = changed.get("path")
            file = (
                [path] if isinstance(path, str) and os.path.isfile(path) else []
            )  # another call has written it
            words = [*right, *HINTS.get(name, ()), "Problem.start", name, *file]
            named = any(
                re.search(rf"(?<![A-Za-z]){re.escape(word)}(?![A-Za-z])", str(error))
                for word in words
            )
            return "" if named else f"{name}: no field in {error}"
        except OSError as error:
            return "" if {"path", "folder"} & set(right) else f"{name}: {error}"
        except TooSlow:
            if any(
                isinstance(value, int) and value == 10**9 for value in changed.values()
            ):  # seconds of motion
                return ""
            raise
    return "" if finite(result) else f"{name}: NaN"


HINTS: dict[str, tuple[str, ...]] = {  # fields that are asked about in place of those given
    "Structure.replace": ("bars", "strings"),
    "SupportMotion": ("SupportMotion.positions",),
    **dict.fromkeys(tc.shapes.ShapeFamily.members, ("force_density",)),
    "ParameterLayout.values": ("parameters",),
    "Plan.robustness": ("Parameters",),
    "Parameters": ("Parameters",),
    **dict.fromkeys(("Mppi", "Mppi, of a cost"), ("SplineNoise.deviation",)),
    "Trajectory.load": ("trajectory",),
    "Plan.load": ("plan",),
    "Tradeoff.load": ("trade-off",),
    "Rollouts.load": ("rollouts",),
    **dict.fromkeys(
        ("rollouts", "rollouts, controls", "rollouts, feedback"), ("control",)
    ),  # a function of time
}


NO_INPUT = {
    "Tension",
    "shapes",
    "AtRest",
    "Clip",
    "Linear",
    "ForceDensity",
    "RestLength",
    "RestLengthRate",
    "RungeKutta4",
    "Single",
    "EquilibriumGuess",
    *("Stiffest", "Even", "Least"),
}
FILLED_IN = {
    *("ClassOne", "Energy", "Multipliers", "Constraints", "Linearization", "Modes"),
    *(
        "Recommendation",
        "Sensitivities",
        "Duals",
        "Certificate",
        "Equilibrium",
        "Report",
        "ClosedLoop",
    ),
    *("Stability", "BucklingFactor", "LoadPath", "Form", "PrestressDesign", "Sized"),
}
RESULTS_AND_MODELS = [
    *("Structure", "Model", "ParameterLayout", "Trajectory", "Tradeoff", "Rollouts", "Sweep"),
    *("Plan", "Robustness", "Mpc", "Mppi", "Tracker"),
]
EQUATIONS = {
    "Model.with_schedule",
    "ParameterLayout.item_values",
    "ParameterLayout.check",
    "Plan.guess",
}  # for the equations' own use


def takes_input(value: Any) -> bool:
    if isinstance(value, staticmethod):
        return bool(inspect.signature(value.__func__).parameters)
    return inspect.isfunction(value) and len(inspect.signature(value).parameters) > 1


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Odd names of files are names in an empty folder."""
    monkeypatch.chdir(tmp_path)


def fuzz(calls: dict[str, Call], count: int) -> None:
    """Make `count` odd calls."""

    @settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def attempt(data: st.DataObject) -> None:
        fault = draw_fault(data.draw, calls)
        assert not fault, fault

    attempt()


def test_odd_input_is_refused_by_name() -> None:
    fuzz(quick_calls(), 200)


def test_odd_input_to_what_simulates_solves_or_draws_is_refused_by_name() -> None:
    fuzz(costly_calls() | ensemble_calls(), 60)


def test_every_public_name_meets_odd_input() -> None:
    """But for names without input, exceptions, and what the packages themselves fill in; methods of goals, loads and schemes take equations."""
    calls = {**quick_calls(), **costly_calls(), **ensemble_calls()}
    met = {
        part
        for name in calls
        for part in (name.partition(",")[0], name.removeprefix("ocp."), name.partition(".")[0])
    }
    public = {name: getattr(package, name) for package in (tc, ocp) for name in package.__all__}
    raised = {
        name
        for name, value in public.items()
        if isinstance(value, type) and issubclass(value, Exception)
    }
    missing = set(public) - met - raised - NO_INPUT - FILLED_IN
    for name in RESULTS_AND_MODELS:
        missing |= (
            {
                f"{name}.{key}"
                for key, value in vars(public[name]).items()
                if key[0] != "_" and takes_input(value)
            }
            - met
            - EQUATIONS
        )
    assert not missing, f"give them a case in tests/support: {sorted(missing)}"


@pytest.mark.slow
def test_each_odd_value_in_each_field_is_refused_by_name() -> None:
    """The draws of the other tests change with each new public name; these do not."""
    for name, (function, right) in quick_calls().items():
        for field, value in right.items():
            for odd in list_odd(value):
                fault = find_fault(name, (function, right), {field: odd})
                assert not fault, f"{field}: {fault}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "calls"), [(0.7, quick_calls), (0.15, costly_calls), (0.15, ensemble_calls)]
)
def test_thousands_of_odd_inputs_are_refused_by_name(
    share: float, calls: Callable[[], dict[str, Call]]
) -> None:
    fuzz(calls(), int(share * NUMBER_OF_CALLS))
