"""Sampling's options: wrong ones are refused by name."""

from __future__ import annotations

import pytest

import ocp

BAD = {
    "no samples": ({"samples": 0}, ValueError, r"Sampling\.samples is 0"),
    "half a round": ({"rounds": 1.5}, TypeError, r"Sampling\.rounds"),
    "a negative seed": ({"seed": -1}, ValueError, r"Sampling\.seed is -1"),
    "no knots": ({"knots": 0}, ValueError, r"Sampling\.knots is 0"),
    "no threads": ({"threads": 0}, ValueError, r"Sampling\.threads is 0"),
    "groups that overlap": (
        {"groups": [(0, 1), (1, 2)]},
        ValueError,
        r"Sampling\.groups has string 1 twice",
    ),
    "groups that are numbers": ({"groups": 3}, TypeError, r"Sampling\.groups"),
    "a flag that is none": ({"verbose": 1}, TypeError, r"Sampling\.verbose"),
    "no function": ({"callback": "me"}, TypeError, r"Sampling\.callback"),
}


@pytest.mark.parametrize("case", BAD)
def test_wrong_options_are_refused(case):
    options, kind, text = BAD[case]
    with pytest.raises(kind, match=text):
        ocp.Sampling(**options)


def test_groups_become_tuples():
    assert ocp.Sampling(groups=[[0, 1], [2]]).groups == ((0, 1), (2,))
    assert hash(ocp.Sampling(groups=[[0, 1]])) == hash(ocp.Sampling(groups=((0, 1),)))


def test_verbose_tells_each_round(capsys):
    from loading import load_example

    problem = load_example("contact_problems").prism_jumps(0.2)
    ocp.solve(
        problem, solver=ocp.Sampling(samples=16, rounds=2, iterations=1, attempts=1, verbose=True)
    )
    assert capsys.readouterr().out.startswith("sampling, round 1: residual of the goals")
