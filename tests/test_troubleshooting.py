"""Every message that the page of troubleshooting quotes is one that the code gives."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
LEAST = 12  # letters of the longest piece of a text that a message is recognized by
SHARE = 0.3  # of the letters of the message that the pieces of this text have
QUOTED = re.findall(r"^`(.+)`$", PAGE, re.MULTILINE)


def texts_of(tree: ast.Module) -> list[str]:
    """All texts of a module, with … for what is put into them."""
    nodes = list(ast.walk(tree))
    pieces = {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    found = []
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            found.append(
                "".join(
                    str(part.value) if isinstance(part, ast.Constant) else "…"
                    for part in node.values
                )
            )
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in pieces
        ):
            found.append(re.sub(r"\{[^}]*\}", "…", node.value))
    return found


@pytest.fixture(scope="module")
def texts() -> dict[str, list[str]]:
    """All texts of the code, with their pieces between what is put into them."""
    modules = [path for package in ("tenscasadi", "ocp") for path in (ROOT / package).rglob("*.py")]
    found = (texts_of(ast.parse(path.read_text(encoding="utf-8"))) for path in modules)
    return {
        text: [piece.strip() for piece in text.split("…")]
        for own in found
        for text in own
        if len(text) >= LEAST
    }


def gives(message: str, texts: dict[str, list[str]]) -> bool:
    """Whether a text contains the message, or the message all pieces of a text."""
    return any(
        message in text
        or (
            all(piece in message for piece in pieces)
            and max(map(len, pieces)) >= LEAST
            and sum(map(len, pieces)) >= SHARE * len(message)
        )
        for text, pieces in texts.items()
    )


def test_there_are_messages():
    assert len(QUOTED) > 40
    assert len(set(QUOTED)) == len(QUOTED)


@pytest.mark.parametrize("message", QUOTED)
def test_the_code_gives_the_message(message, texts):
    assert gives(message, texts)


def test_a_message_that_nothing_gives_is_noticed(texts):
    assert not gives("the step … s is above the fairness limit", texts)


def test_each_message_has_a_cause():
    entries = re.split(r"^`.+`$", PAGE, flags=re.MULTILINE)[1:]
    assert all(entry.startswith("\n:   **Cause**: ") for entry in entries)
