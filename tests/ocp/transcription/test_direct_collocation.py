"""Direct collocation: the degrees that there are."""

from __future__ import annotations

import pytest

import ocp


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ocp.DirectCollocation(5, degree=0), "DirectCollocation.degree is 0"),
        (
            lambda: ocp.DirectCollocation(5, degree=12),
            "DirectCollocation.degree is 12: it must be at most 9",
        ),
    ],
)
def test_wrong_values_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
