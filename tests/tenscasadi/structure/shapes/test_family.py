"""All shapes: keywords, prestress, names and documents."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced

from tenscasadi.structure import shapes
from tenscasadi.structure.shapes.family import ShapeFamily
from tenscasadi.structure.structure import Structure

MEMBERS = pytest.mark.parametrize("make", ShapeFamily.members.values(), ids=ShapeFamily.members)


@MEMBERS
def test_keywords_reach_the_structure(make: Callable[..., Structure]) -> None:
    s = make(stiffness=7.0, damping=0.5, bar_radius=0.01)
    assert np.all(s.stiffness == 7.0)
    assert np.all(s.damping == 0.5)
    assert np.all(s.bar_radius == 0.01)
    np.testing.assert_array_equal(s.rest_length, s.string_lengths)  # not prestressed unless asked
    assert make.__doc__ is not None
    assert "0" in make.__doc__  # numbered
    assert getattr(shapes, make.__name__) is make


@pytest.mark.parametrize(
    "make",
    [
        make
        for make in ShapeFamily.members.values()
        if "prestress" in inspect.signature(make).parameters
    ],
    ids=lambda make: make.__name__,
)
def test_prestress_is_the_smallest_force_density_in_equilibrium(
    make: Callable[..., Structure],
) -> None:
    s = make(prestress=2.0, stiffness=1e6)
    assert gamma_of(s).min() == pytest.approx(2.0, rel=1e-6)
    assert unbalanced(s, gamma_of(s)) < 1e-6
    with pytest.raises(ValueError, match="prestress and rest_length are both given"):
        make(prestress=2.0, rest_length=1.0)


def test_earlier_name_of_the_family_warns() -> None:
    with pytest.warns(DeprecationWarning, match="use tenscasadi.structure.shapes.ShapeFamily"):
        assert shapes.Shape is ShapeFamily
