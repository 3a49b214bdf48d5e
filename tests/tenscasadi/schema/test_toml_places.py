"""The scanner tells the same keys as the parser, on the lines where they are."""

from __future__ import annotations

import sys
import time
from typing import Any

import pytest

from tenscasadi.schema.toml_places import Key, TooMuch, find_lines

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
inline = { one = 1, two = { three = [7, 8] }, empty = {}, "k.l" = 1979-05-27 }
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


def test_every_key_has_a_line():
    lines = find_lines(TEXT)
    wanted = keys(tomllib.loads(TEXT))
    assert wanted - {("plan",)} <= lines.keys()
    rows = TEXT.splitlines()
    assert {key for key in lines if key not in wanted} == set()
    for key, start in {
        ("format",): "format",
        ("a", "b", "c d"): "a.b",
        ("numbers", "literal"): "literal",
        ("structure", "nodes", 1, 2): "   5]",
        ("structure", "inline", "two", "three", 1): "inline",
        ("plan", "goals", 1, "kind"): 'kind = "B"',
        ("plan", "goals", 0, "inner", "x"): "x = 1",
        ("plan", "goals", 1, "phases", 1, "y"): "y = 2",
    }.items():
        assert rows[lines[key] - 1].startswith(start), key


@pytest.mark.parametrize(
    "text",
    [
        "a." * 3_000_000 + "a = 1",
        "x = " + "[" * 1_000_000,
        "x = " + "{a=" * 1_000_000,
        "[" + "a." * 100_000 + "a]",
    ],
)
def test_deep_texts_are_refused_before_a_parser_gets_lost(text):
    began = time.process_time()
    with pytest.raises(TooMuch) as fault:
        find_lines("ok = 1\n" + text)
    assert fault.value.line == 2
    assert time.process_time() - began < 5.0


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x = [" + "1," * 8_000_000 + "]", 2),
        ("a.a.a.a.a.a.a.a.a.a = 1\n" * 600_000, 2000),
        ("[a.b.c.d]\n" * 1_000_000, 5000),
        ("[[a]]\n" * 2_000_000, 10_001),
    ],
)
def test_floods_of_entries_are_refused_before_a_parser_reads_them(text, line):
    began = time.process_time()
    with pytest.raises(TooMuch, match="keys and entries of lists") as fault:
        find_lines("ok = 1\n" + text, 20_000)
    assert abs(fault.value.line - line) <= 2
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize(
    "text",
    [
        "'" * 100_000,
        '"""' + "\\" * 1_000_000,
        'x = "' + "\\" * 1_000_000,
        "x = [1, 2",
        "= 1",
        "[a",
        "x = [1 2]",
        "x",
        "x =",
    ],
)
def test_malformed_texts_come_to_an_end(text):
    began = time.process_time()
    assert find_lines("ok = 1\n" + text)["ok",] == 1
    assert time.process_time() - began < 5.0


def test_lines_after_many_comments_are_right():
    assert find_lines(
        "# note\n" * 5000
        + "a = 1\n"
        + "\n# note\n" * 3000
        + 'b = """\n'
        + '"" \\"\n' * 3000
        + '"""\nc = 1'
    ) == {
        ("a",): 5001,
        ("b",): 11002,
        ("c",): 14004,
    }
