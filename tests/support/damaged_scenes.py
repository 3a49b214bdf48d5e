"""Scene files that are damaged or wrong, drawn by hypothesis from right ones."""

from __future__ import annotations

import re
from collections.abc import Callable

from hypothesis import strategies as st

ODD = [
    *(
        "-1",
        "0",
        "1e300",
        "1e400",
        "nan",
        "inf",
        "-inf",
        "1e-320",
        "99999999999999999999",
        "3.5",
        "true",
        "2024-01-01",
        "''",
        "[]",
        "{}",
        "[1, 2",
    ),
    *(
        "[[[[1]]]]",
        "['x', 'y', 'z']",
        "{ kind = 'Nothing' }",
        "'no such word'",
        "'1 / 0'",
        "'9 ** 9 ** 9 ** 9'",
        "'sqrt(-1)'",
        "'2 t'",
        "'unknown * 2'",
    ),
    *(
        "\"__import__('os').system('touch taken')\"",
        "\"open('taken', 'w')\"",
        "'().__class__.__mro__'",
        "'../../../etc/passwd'",
        "'\\u0000'",
        "'(' * 3",
    ),
    *(
        f"'{'(' * 3000}1{')' * 3000}'",
        f"{'[' * 500}{']' * 500}",
        "[0, 0, 0, 0]",
        "[1e200, 0, 0]",
        "[nan, 0, 0]",
    ),
]
ADDED = [
    *(
        "include = ['../outside.toml']",
        "include = ['/etc/passwd']",
        "include = ['scene.toml']",
        "include = [1]",
        "include = 'link.toml'",
        "nonsense = 1",
    ),
    *(
        "[nonsense]",
        "[structure]",
        "[[structure]]",
        "[plan.nonsense]",
        "[numbers]\nt = 1",
        "[numbers]\na = 'b'\nb = 'a'",
        "a.b.c.d.e.f.g.h.i.j.k.l.m.n = 1",
    ),
    *(
        "[plan.solver]\nkind = 'Ipopt'\noptions = { hsllib = 'evil.so' }",
        "[plan.solver]\nkind = 'Ipopt'\noptions = { output_file = 'taken' }",
    ),
]
_PAIR = re.compile(r"^(\s*)([\w.]+)( *= *)(.+?)(\s+#.*)?$")


def damaged_scene(draw: Callable[..., object], right: str) -> bytes:
    """The text of a scene file with one or two faults."""
    content = right.encode()
    for _ in range(draw(st.integers(1, 2))):
        content = draw(st.sampled_from(_WAYS))(draw, content)
    return content


def _odd_value(draw: Callable[..., object], content: bytes) -> bytes:
    return _in_a_pair(
        draw, content, lambda pair: f"{pair[1]}{pair[2]}{pair[3]}{draw(st.sampled_from(ODD))}"
    )


def _odd_key(draw: Callable[..., object], content: bytes) -> bytes:
    return _in_a_pair(
        draw, content, lambda pair: f"{pair[1]}{pair[2][:-1] or 'x'}_{pair[3]}{pair[4]}"
    )


def _gone(draw: Callable[..., object], content: bytes) -> bytes:
    return _in_a_pair(draw, content, lambda pair: "")


def _twice(draw: Callable[..., object], content: bytes) -> bytes:
    return _in_a_pair(draw, content, lambda pair: f"{pair[0]}\n{pair[0]}")


def _in_a_pair(
    draw: Callable[..., object], content: bytes, change: Callable[[re.Match[str]], str]
) -> bytes:
    lines = content.decode(errors="replace").splitlines()
    pairs = {k: found for k, line in enumerate(lines) if (found := _PAIR.match(line))}
    if not pairs:
        return content + b"\n= 1"
    place = draw(st.sampled_from(sorted(pairs)))
    lines[place] = change(pairs[place])
    return "\n".join(lines).encode()


def _added(draw: Callable[..., object], content: bytes) -> bytes:
    added = draw(st.sampled_from(ADDED)).encode()
    return added + b"\n" + content if draw(st.booleans()) else content + b"\n" + added + b"\n"


def _cut(draw: Callable[..., object], content: bytes) -> bytes:
    return content[: draw(st.integers(0, max(0, len(content) - 1)))]


def _flipped(draw: Callable[..., object], content: bytes) -> bytes:
    if not content:
        return b"\xff"
    changed = bytearray(content)
    for place in draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=8)):
        changed[place] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


_WAYS = (*[_odd_value] * 6, _odd_key, _odd_key, _gone, _twice, _added, _added, _cut, _flipped)
