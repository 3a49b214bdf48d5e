"""Old names and keywords still work, and warn."""

from __future__ import annotations

import inspect

import pytest

from tenscasadi.util.renamed import RenamedAttribute, find_renamed, rename_keywords


@rename_keywords(colour="color")
def paint(thing: str, *, color: str = "red") -> str:
    """Paint a thing."""
    return f"{color} {thing}"


def test_old_keyword_warns_and_works():
    with pytest.warns(DeprecationWarning, match=r"paint\(colour=\) is deprecated: use color="):
        assert paint("bar", colour="blue") == "blue bar"
    assert paint("bar", color="blue") == "blue bar"
    assert list(inspect.signature(paint).parameters) == ["thing", "color"]


def test_old_and_new_keyword_together_are_rejected():
    with pytest.raises(TypeError, match="leave colour out"):
        paint("bar", colour="blue", color="red")


def test_old_name_warns_and_unknown_name_is_rejected():
    find = find_renamed("package", {"Centre": ("Center", 3)})
    with pytest.warns(DeprecationWarning, match=r"package\.Centre is deprecated"):
        assert find("Centre") == 3
    with pytest.raises(AttributeError, match="has no attribute 'other'"):
        find("other")


def test_old_attribute_warns_and_works():
    class Cup:
        color = "red"
        colour = RenamedAttribute("color")

    with pytest.warns(DeprecationWarning, match=r"Cup\.colour is deprecated: use color"):
        assert Cup().colour == "red"
