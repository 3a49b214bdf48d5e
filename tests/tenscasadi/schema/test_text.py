"""Texts are parsed, every key has its line, and what is written comes back to the last bit."""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tenscasadi.schema.text import Key, TextError, find_line, parse, to_json, to_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEXT = '''# a comment with [brackets] and "quotes
format = 1
a.b."c d" = "text with ] and \\" and #"
[numbers]
height = "2 * radius"   # [comment
long = """
[no.table]
x = 1"""
literal = \'\'\'it's
y = 2\'\'\'
[structure]
nodes = [
  [0, 1, 2],  # ] first
  [3, "a]b",
   5],
]
inline = { one = 1, two = { three = [7, 8] }, empty = {}, "k.l" = 2.5 }
[structure.bars.legs]
members = [["a", "b"]]
[[plan.goals]]
kind = "A"
[plan.goals.inner]
x = 1
[[plan.goals]]
kind = "B"
[[plan.goals.phases]]
y = 1
[[plan.goals.phases]]
y = 2
'''
DATA = tomllib.loads(TEXT)


def keys(value: Any, key: Key = ()) -> set[Key]:
    found = {key} if key else set()
    entries = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    return found.union(*(keys(entry, (*key, word)) for word, entry in entries))


@pytest.mark.parametrize("text", [TEXT, json.dumps(DATA, indent=1), json.dumps(DATA)])
def test_every_key_has_a_line(text):
    rows = text.splitlines()
    for key in keys(DATA):
        words, line = find_line(text, key)
        assert words == len(key), key
        word = key[-1] if isinstance(key[-1], str) else ""
        assert word in rows[line - 1] or key == ("plan",), key


def test_lines_of_entries_are_exact():
    rows = TEXT.splitlines()
    for key, start in {
        ("structure", "nodes", 1, 2): "   5]",
        ("structure", "inline", "two", "three", 1): "inline",
        ("plan", "goals", 1, "kind"): 'kind = "B"',
        ("plan", "goals", 0, "inner", "x"): "x = 1",
        ("plan", "goals", 1, "phases", 1, "y"): "y = 2",
    }.items():
        assert rows[find_line(TEXT, key)[1] - 1].startswith(start), key
    assert find_line(TEXT, ("structure", "nodes", 7))[0] == 2
    comments = "# note\n" * 5000 + "a = 1\n" + "\n# note\n" * 3000 + 'b = """\n' + '"" \\"\n' * 3000
    assert find_line(comments + '"""\nc = 1', ("c",)) == (1, 14004)


@pytest.mark.parametrize(
    "text",
    [
        "a." * 3_000_000 + "a = 1",
        "x = " + "[" * 1_000_000,
        "x = " + "{a=" * 1_000_000,
        "[" + "a." * 100_000 + "a]",
        '"a". ' * 100_000 + "a = 1",
    ],
)
def test_deep_texts_are_rejected_at_once(text):
    began = time.process_time()
    with pytest.raises(TextError) as fault:
        parse("ok = 1\n" + text, "toml", 10**7)
    assert fault.value.line == 2
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize(
    "text", ["x = [" + "1," * 8_000_000 + "]", "a.a = 1\n" * 600_000, "[[a]]\n" * 2_000_000]
)
def test_floods_of_entries_are_rejected_at_once(text):
    began = time.process_time()
    with pytest.raises(TextError, match="keys and entries of lists"):
        parse(text, "toml", 20_000)
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize(
    ("text", "language", "line"),
    [
        ("ok = 1\n'", "toml", 2),
        ('x = """' + "\\" * 100_000, "toml", 1),
        ("x = [1, 2", "toml", 1),
        ("ok = 1\n\nx = [1 2]", "toml", 3),
        ('{"a": 1,\n "b": }', "json", 2),
        ('{"a": 1, "a": 2}', "json", None),
        ("[1]", "json", 1),
    ],
)
def test_malformed_texts_are_rejected_with_their_line(text, language, line):
    with pytest.raises(TextError) as fault:
        parse(text, language, 10**6)
    assert fault.value.line == line


# --- writing ---

texts = st.text(st.characters(codec="utf-8"), max_size=8)
numbers = st.floats(allow_nan=False, allow_infinity=False)
leaves = st.one_of(st.integers(-(2**60), 2**60), numbers, st.booleans(), texts)
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


@settings(deadline=None, max_examples=50)
@given(st.dictionaries(texts, values, max_size=5))
def test_tables_come_back(data):
    assert exact(tomllib.loads(to_toml(data))) == exact(data)
    assert exact(json.loads(to_json(data))) == exact(data)


def test_infinity_is_text_in_json():
    assert json.loads(to_json({"upper": [1.0, float("inf")]})) == {"upper": [1.0, "inf"]}


def test_lines_are_short_where_they_can_be():
    text = to_toml(
        {
            "nodes": [[1 / 3] * 3] * 20,
            "ground": [{"heights": [[0.1] * 5] * 5, "kind": "Terrain"}] * 2,
        }
    )
    assert max(map(len, text.splitlines())) <= 100
    assert text.count("[[ground]]") == 2
