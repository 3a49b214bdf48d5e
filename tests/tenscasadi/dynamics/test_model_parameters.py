"""Parameters that change no motion are refused by name; those that set the default control alone are warned of."""

from __future__ import annotations

import copy
import warnings

import pytest

import tenscasadi as tc

PRISM = tc.shapes.prism(prestress=20.0, damping=1.0)
MASSIVE = tc.shapes.prism(string_mass=0.1)
WEIGHT = tc.Structure(
    [(0, 0, 0), (0, 0, -1), (1, 0, -1)],
    bars=[(1, 2)],
    strings=[(0, 1)],
    pinned=[0, 1, 2],
    node_mass=[0, 1.0, 1.0],
)


@pytest.mark.parametrize(
    ("scene", "names", "message"),
    [
        (
            {"structure": PRISM, "control": tc.ForceDensity()},
            ("bar_mass", "damping"),
            r"'damping', which has no effect on this scene \(under ForceDensity\(\)",
        ),
        (
            {"structure": MASSIVE},
            ("string_mass",),
            r"'string_mass', which has no effect on this scene \(strings have mass where segments= cuts them\): remove the name",
        ),
    ],
    ids=["damping of commanded force densities", "mass of strings in one piece"],
)
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_what_nothing_depends_on_is_refused(scene, names, message, coordinates):
    with pytest.raises(ValueError, match=message):
        tc.Model(tc.Scene(**scene, parameters=tc.Parameters(*names)), coordinates)


@pytest.mark.parametrize(
    ("control", "names", "commanded"),
    [
        (tc.ForceDensity(), ("bar_mass", "stiffness"), "force densities"),
        (tc.RestLength(), ("stiffness", "rest_length"), "rest lengths"),
    ],
    ids=str,
)
def test_what_sets_the_default_control_alone_is_warned_of(control, names, commanded):
    with pytest.warns(
        UserWarning,
        match=f"has '{names[1]}', which only sets the default control: .* {commanded} are commanded",
    ) as told:
        model = tc.Model(tc.Scene(PRISM, control=control, parameters=tc.Parameters(*names)))
    assert len(told) == 1
    assert told[0].filename == __file__
    values, given = (
        {names[1]: 2 * model.parameters.values()[model.parameters.places[names[1]]]},
        model.initial_control,
    )
    ends = [
        tc.simulate(model, 0.05, 0.01, control=given, parameters=p, compiled=False).states[-1]
        for p in (None, values)
    ]
    assert (ends[0] == ends[1]).all()
    assert (model.control_at(model.parameters.values(values)) != given).any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        copy.deepcopy(model)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_what_motions_depend_on_is_taken(coordinates):
    ground = tc.Ground(damping=1.0, friction=0.5)
    scene = tc.Scene(
        PRISM, gravity=tc.Gravity(), ground=ground, pressure=tc.Pressure([(0, 1, 2)], 1.0)
    )
    names = (
        "stiffness",
        "damping",
        "rest_length",
        "bar_mass",
        "node_mass",
        "gravity",
        "ground_stiffness",
        "ground_damping",
        "ground_friction",
        "pressure",
    )
    assert tc.Model(
        tc.Scene(**{**vars_of(scene), "parameters": tc.Parameters(*names)}), coordinates
    ).np > len(names)
    cut = tc.Model(
        tc.Scene(MASSIVE, segments=2, parameters=tc.Parameters("string_mass")), coordinates
    )
    assert cut.np == len(MASSIVE.strings)
    nothing_moves = tc.Scene(WEIGHT, parameters=tc.Parameters("bar_mass"))
    assert tc.Model(nothing_moves).nq == 0


def vars_of(scene):
    return {name: getattr(scene, name) for name in ("structure", "gravity", "ground", "pressure")}
