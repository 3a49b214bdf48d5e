"""The troubleshooting page quotes whole messages of the code, and the code names its entries."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import product
from math import prod
from pathlib import Path

import pytest

import tenscasadi as tc
from tenscasadi.util.troubleshooting import (
    PAGE,
    add_address,
    append_address,
    describe_address,
    find_address,
)

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
ENTRIES = re.findall(r"^`(.+)`\{: #([a-z0-9-]+) \}$", TEXT, re.MULTILINE)
MOST = 64  # variants of a text
Names = dict[str, list[ast.expr]]


def expand(node: ast.expr, names: Names, depth: int = 0) -> list[str]:
    """All texts of an expression, with … for what is put into them.

    Names of texts that the same function assigns are replaced by these texts.
    """
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [re.sub(r"\{[^}]*\}", "…", node.value)]
    if isinstance(node, ast.FormattedValue):
        return expand(node.value, names, depth)
    if isinstance(node, ast.IfExp):
        return expand(node.body, names, depth) + expand(node.orelse, names, depth)
    if isinstance(node, ast.Name) and node.id in names and depth < 4:
        return [text for own in names[node.id] for text in expand(own, names, depth + 1)] or ["…"]
    if isinstance(node, (ast.JoinedStr, ast.BinOp)):
        own = node.values if isinstance(node, ast.JoinedStr) else [node.left, node.right]
        parts = [expand(part, names, depth) for part in own]
        if prod(map(len, parts)) > MOST:
            parts = [part[:1] for part in parts]
        return ["".join(part) for part in product(*parts)]
    return ["…"]


def assigned(statements: list[ast.stmt]) -> Names:
    """Texts that statements assign, by name."""
    names: Names = {}
    for node in (node for statement in statements for node in ast.walk(statement)):
        if not isinstance(node, ast.Assign):
            continue
        target, value = node.targets[0], node.value
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=False))
        for name, own in pairs:
            if isinstance(name, ast.Name) and isinstance(
                own, (ast.Constant, ast.JoinedStr, ast.IfExp, ast.BinOp)
            ):
                names.setdefault(name.id, []).append(own)
    return names


def functions() -> Iterator[tuple[str, ast.AST, Names]]:
    """Modules and functions of the code, with the texts that they name."""
    for path in (path for name in ("tenscasadi", "ocp") for path in (ROOT / name).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        known = assigned([node for node in tree.body if isinstance(node, ast.Assign)])
        yield path.name, tree, known
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                yield path.name, node, known | assigned(node.body)


@pytest.fixture(scope="module")
def texts() -> set[str]:
    """All whole texts of the code but docstrings."""
    found = set()
    for _, function, names in functions():
        for node in ast.walk(function):
            if isinstance(node, ast.JoinedStr) or (
                isinstance(node, ast.Constant) and isinstance(node.value, str)
            ):
                found |= {" ".join(text.split()) for text in expand(node, names)}
    return {text for text in found if len(text.replace("…", "")) > 10}


def gives(message: str, texts: set[str]) -> bool:
    """Whether a text is the message, whatever is put into both."""
    pattern = re.compile(".+".join(map(re.escape, message.split("…"))))
    return any(pattern.fullmatch(text) for text in texts)


def test_there_are_entries():
    assert len(ENTRIES) > 60
    assert len(ENTRIES) == len(re.findall(r"^`.+`", TEXT, re.MULTILINE))
    for column in zip(*ENTRIES, strict=True):
        assert len(set(column)) == len(ENTRIES)


@pytest.mark.parametrize("message", [message for message, _ in ENTRIES])
def test_the_code_gives_the_message(message, texts):
    assert gives(message, texts)


@pytest.mark.parametrize(
    "message",
    [
        "the step … s is above the fairness limit",
        "the step … s is above the stability limit",  # a piece of one
        "bars are off by up to … of their length",
    ],
)
def test_messages_that_nothing_gives_are_noticed(message, texts):
    assert not gives(message, texts)


def test_each_message_has_a_cause():
    entries = re.split(r"^`.+`\{: #.+ \}$", TEXT, flags=re.MULTILINE)[1:]
    assert all(entry.startswith("\n:   **Cause**: ") for entry in entries)


@pytest.mark.parametrize(("message", "anchor"), ENTRIES)
def test_messages_have_the_address_of_their_entry(message, anchor):
    assert find_address(message) == f"{PAGE}#{anchor}"
    assert find_address(f"before: {message} after") == f"{PAGE}#{anchor}"


def test_errors_with_an_entry_carry_its_address():
    """Each `raise` of a message with an entry does so by `add_address`."""
    without = []
    for module, function, names in functions():
        for node in ast.walk(function):
            if not isinstance(node, ast.Raise) or not isinstance(node.exc, ast.Call):
                continue
            call = ast.unparse(node.exc.func)
            by_itself = call.endswith((".error", "SceneFileError", "FormulaError", "TextError"))
            by_itself |= call == "NotWritten"  # a part of another message
            texts = [text for own in node.exc.args[:2] for text in expand(own, names)]
            if call != "add_address" and not by_itself and any(map(find_address, texts)):
                without.append(f"{module}, line {node.lineno}: {texts[0]}")
    assert without == []


def test_errors_have_a_note(tmp_path):
    with pytest.raises(ValueError, match="move one or remove") as caught:
        tc.Structure([[0, 0, 0], [0, 0, 0]], bars=[[0, 1]])
    assert caught.value.__notes__ == [f"See {PAGE}#member-without-length"]
    (tmp_path / "mast.toml").write_text("format = 2\nunits = 'SI'\n[structur]\n")
    with pytest.raises(tc.SceneFileError) as caught:
        tc.load_scene(tmp_path / "mast.toml")
    assert not hasattr(caught.value, "__notes__")  # the page has no entry
    (tmp_path / "mast.toml").write_text("units = 'SI'")
    with pytest.raises(tc.SceneFileError) as caught:
        tc.load_scene(tmp_path / "mast.toml")
    assert caught.value.__notes__ == [f"See {PAGE}#no-format"]


def test_warnings_and_summaries_name_the_address():
    square = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    flat = tc.Structure(square, bars=[[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [0, 3]])
    with pytest.warns(tc.RedundantConstraints, match=r"see docs/.*#redundant-constraints"):
        tc.Model(tc.Scene(flat))
    model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=1000.0, prestress=50.0)))
    spun = model.state(model.structure.nodes, model.structure.nodes[:, [1, 0, 2]] * [1, -1, 0])
    run = tc.simulate(model, 2.0, 0.1, state=spun, compiled=False)
    assert not run.success
    address = find_address(run.message)
    assert address
    assert run.summary().endswith(f"\nsee           {address}")


def test_other_texts_have_no_address():
    assert find_address("finished 100 steps of 0.001 s") == ""
    assert append_address("finished") == "finished"
    assert describe_address("finished") == []
    assert not hasattr(add_address(ValueError("x is 3: give 4")), "__notes__")
