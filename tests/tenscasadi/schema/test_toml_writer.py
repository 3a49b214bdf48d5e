"""Tables become TOML that every parser reads back as they were."""

from __future__ import annotations

import struct
import sys
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from tenscasadi.schema.toml_writer import to_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

texts = st.text(st.characters(codec="utf-8"), max_size=8)
leaves = st.one_of(
    st.integers(-(2**60), 2**60),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
    texts,
)
values = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(texts, inner, max_size=3),
        st.lists(st.dictionaries(texts, inner), max_size=2),
        st.lists(st.lists(leaves, max_size=9), max_size=9),
    ),
    max_leaves=20,
)


def exact(value: Any) -> Any:
    """A value that is equal only where every bit and type is; tables may change their order."""
    if isinstance(value, dict):
        return {name: exact(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [exact(entry) for entry in value]
    return struct.pack("d", value) if isinstance(value, float) else (type(value), value)


@settings(deadline=None)
@given(st.dictionaries(texts, values, max_size=5))
def test_tables_come_back(data):
    assert exact(tomllib.loads(to_toml(data))) == exact(data)


def test_lines_are_short_where_they_can_be():
    text = to_toml(
        {
            "nodes": [[1 / 3] * 3] * 20,
            "ground": [{"heights": [[0.1] * 5] * 5, "kind": "Terrain"}] * 2,
        }
    )
    assert max(map(len, text.splitlines())) <= 120
    assert text.count("[[ground]]") == 2
