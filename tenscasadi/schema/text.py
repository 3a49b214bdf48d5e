"""TOML and JSON: parsing, line numbers of keys, and formatting."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Key = tuple[str | int, ...]  # names in tables and indices in lists, from the root

_WORD = r"[A-Za-z0-9_-]+|\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'"
_KEY = rf"(?:{_WORD})(?:[ \t]*\.[ \t]*(?:{_WORD}))*"
_PAIR = re.compile(rf"({_KEY})\s*[=:]\s*")
_HEAD = re.compile(rf"\[(\[?)[ \t]*({_KEY})[ \t]*\]\]?")
_SPACE = re.compile(r"\s+|#[^\n]*")
_SCALAR = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|[^,\]}\n#]+',
    re.DOTALL,
)
_DEEP = re.compile(
    rf"(?:^|[{{,\[])[ \t]*(?:(?:{_WORD})[ \t]*\.[ \t]*){{12}}|(?:[\[{{]\s*(?:[\w-]+\s*=\s*)?){{13}}",
    re.MULTILINE,
)
_POSITION = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)")


class TextError(ValueError):
    """Raised for invalid TOML or JSON, with its `line`."""

    def __init__(self, message: str, line: int | None) -> None:
        super().__init__(message)
        self.line = line


def parse(text: str, language: str, most: float = math.inf) -> dict[str, Any]:
    """Parse a text in "toml" or "json" to a dictionary.

    `language` is one of these words. The text may have at most `most` keys and entries of lists.
    Raises TextError.
    """
    if sum(map(text.count, ",=:[")) > most:
        raise TextError(f"it has more than {most} keys and entries of lists: give fewer", None)
    if language == "toml" and (found := _DEEP.search(text)):  # parsing takes quadratic time
        nested = "more than 12 lists, tables or words of a key lie inside each other"
        raise TextError(f"{nested}: write it flatter", text.count("\n", 0, found.end()) + 1)
    try:
        data = _parse_json(text) if language == "json" else _parse_toml(text)
    except json.JSONDecodeError as error:
        raise TextError(f"it is no JSON, {error.msg}: correct it there", error.lineno) from None
    except (ValueError, RecursionError) as error:
        found = _POSITION.search(str(error))
        fault = (
            _POSITION.sub("", str(error)) if isinstance(error, ValueError) else "nested too deep"
        )
        line = found and int(found[1] or text.count("\n") + 1)
        message = f"it is no {language.upper()}, {fault}: correct it there"
        raise TextError(message, line) from None
    if not isinstance(data, dict):
        raise TextError("it is no table: give keys with values", 1)
    return data


def _parse_toml(text: str) -> Any:
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    return tomllib.loads(text)


def _parse_json(text: str) -> Any:
    def collect(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [name for name, _ in pairs]
            raise ValueError(f"key {max(names, key=names.count)!r} stands twice in one table")
        return table

    return json.loads(text, object_pairs_hook=collect)


def find_line(text: str, key: Key) -> tuple[int, int]:
    """Find the line of a key in TOML or JSON.

    Returns how many leading words of `key` the text has, and the line of the last of them.
    """
    count = best = at = 0
    frames: list[list[Any]] = [[(), "", None]]  # key, closing bracket, index in a list
    latest: dict[Key, int] = {}  # index of the latest table of an array of tables
    while at < len(text):
        path, end, index = frame = frames[-1]
        place, start = path if index is None else (*path, index), at
        if found := _SPACE.match(text, at):
            at = found.end()
            continue
        if text[at] in (end, ","):
            frame[2] = index if index is None else index + 1
            if text[at] == end:
                frames.pop()
            at += 1
            continue
        if not end and (found := _HEAD.match(text, at)):
            place = ()
            for word in _words(found[2]):
                place += (latest[place], word) if place in latest else (word,)
            if found[1]:
                latest[place] = latest.get(place, -1) + 1
            frame[0] = place = (*place, latest[place]) if place in latest else place
        elif index is None and (found := _PAIR.match(text, at)):
            place = path + _words(found[1])
        at = found.end() if found else at
        for k in range(count + 1, min(len(place), len(key)) + 1):
            if place[:k] == key[:k]:
                count, best = k, start
        if found and found.re is _HEAD:
            continue
        if text[at : at + 1] in ("[", "{"):
            frames.append([place, "]}"[text[at] == "{"], 0 if text[at] == "[" else None])
            at += 1
        else:
            at = found.end() if (found := _SCALAR.match(text, at)) else at + 1
    return count, text.count("\n", 0, best) + 1


def _words(key: str) -> Key:
    words = re.findall(_WORD, key)
    return tuple(json.loads(word) if word[0] == '"' else word.strip("'") for word in words)


def to_json(data: Mapping[str, Any]) -> str:
    """Format nested `data` as JSON; infinity is the text "inf"."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: plain(entry) for name, entry in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(entry) for entry in value]
        return str(value) if isinstance(value, float) and math.isinf(value) else value

    return json.dumps(plain(data), indent=1, ensure_ascii=False) + "\n"


def to_toml(data: Mapping[str, Any], width: int = 100) -> str:
    """Format nested `data` as TOML.

    Lines have at most `width` characters where that is possible.
    """
    return "\n".join(_table(data, (), width)).strip("\n") + "\n"


def _table(data: Mapping[str, Any], path: tuple[str, ...], width: int) -> Iterator[str]:
    later: dict[str, Any] = {}
    for name, value in data.items():
        tables = [value] if isinstance(value, Mapping) else value
        line = f"{_word(name)} = {_inline(value)}"
        if not isinstance(tables, list) or (len(line) <= width and (path or tables is value)):
            yield line
        elif tables and all(isinstance(entry, Mapping) for entry in tables):
            later[name] = value
        else:
            yield from (f"{_word(name)} = [", *(f"    {_inline(x)}," for x in value), "]")
    for name, value in later.items():
        head = ".".join(map(_word, (*path, name)))
        for entry in value if isinstance(value, list) else [value]:
            yield from ("", f"[[{head}]]" if isinstance(value, list) else f"[{head}]")
            yield from _table(entry, (*path, name), width)


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_word(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _word(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _inline(name)
