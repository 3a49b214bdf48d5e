"""Where the keys of a TOML text stand: the line of each, also of the entries of lists, as parsers of TOML do not tell it."""

from __future__ import annotations

import re
from contextlib import suppress

Key = tuple[str | int, ...]

DEEPEST = 12  # lists and tables inside each other, and words of a dotted key
# keys, words of dotted keys, entries of lists: what a text of 2 bytes each would cost the parser is
# more than half a minute
MOST_PLACES = 1_000_000

_BLANK = re.compile(r"[ \t]*")
_SPACE = re.compile(
    r"(?:[ \t\r\n]+|#[^\n]*){1,1000}"
)  # a match remembers each turn: without a limit it takes 100 bytes of memory a byte
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PLAIN = re.compile(r"[^,\]}\n#]*")
_TEXTS = [  # the longer quotes first
    re.compile(r'"""[^"\\]*(?:(?:\\.|"{1,2}(?!"))[^"\\]*)*"{3,5}', re.DOTALL),
    re.compile(r"'''.*?'{3,5}", re.DOTALL),
    re.compile(r'"([^"\\\n]*(?:\\.[^"\\\n]*)*)"'),
    re.compile(r"'([^'\n]*)'"),
]


class TooMuch(ValueError):
    """Keys and values are nested deeper, or are more, than files of this format need; `line` says where that begins."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


class _Malformed(Exception):
    """The text is no TOML: the parser says how."""


def find_lines(text: str, most: int = MOST_PLACES) -> dict[Key, int]:
    """Return the line, from 1 on, of each of at most so many keys and list entries of a TOML text; where it is malformed, of those before.

    Raises TooMuch before a parser would get lost in the text.
    """
    scanner = _Scanner(text, most)
    with suppress(_Malformed):
        scanner.read()
    return scanner.lines


class _Scanner:
    """One pass over the text, with the place `at` that it has come to."""

    def __init__(self, text: str, most: int) -> None:
        self.text, self.at = text, 0
        self._left = most
        self.lines: dict[Key, int] = {}
        self._line, self._counted = 1, 0
        self._lengths: dict[Key, int] = {}  # of arrays of tables

    def read(self) -> None:
        table: Key = ()
        while self._skip(_SPACE) < len(self.text):
            if self.text[self.at] == "[":
                double = self.text.startswith("[[", self.at)
                self.at += 1 + double
                name = self._key()
                table = self._resolve(name[:-1]) + name[-1:]
                for k in range(1, len(table) + 1):
                    self._tell(table[:k])
                if double:
                    count = self._lengths[table] = self._lengths.get(table, 0) + 1
                    table = (*table, count - 1)
                    self._tell(table)
                else:
                    table = self._resolve(name)
                self._expect("]]" if double else "]")
            else:
                self._pair(table)

    def _resolve(self, name: Key) -> Key:
        """Return the key of a table's name: arrays of tables in it mean their latest table."""
        key: Key = ()
        for word in name:
            key = (*key, word)
            if key in self._lengths:
                key = (*key, self._lengths[key] - 1)
        return key

    def _pair(self, table: Key) -> None:
        name = self._key()
        for k in range(1, len(name) + 1):
            self._tell(table + name[:k])
        self._expect("=")
        self._value(table + name, 0)

    def _key(self) -> Key:
        words: list[str] = []
        while True:
            self._skip(_BLANK)
            found = (
                _BARE.match(self.text, self.at)
                or _TEXTS[2].match(self.text, self.at)
                or _TEXTS[3].match(self.text, self.at)
            )
            if found is None:
                raise _Malformed
            words.append(found[found.lastindex or 0])
            if len(words) > DEEPEST:
                raise self._too_deep()
            self.at = found.end()
            self._skip(_BLANK)
            if not self.text.startswith(".", self.at):
                return tuple(words)
            self.at += 1

    def _value(self, key: Key, depth: int) -> None:
        if depth > DEEPEST:
            raise self._too_deep()
        self._skip(_BLANK)
        first = self.text[self.at : self.at + 1]
        if first in ("[", "{") and first:
            self.at += 1
            self._items(key, depth, "]" if first == "[" else "}")
            return
        for form in [*_TEXTS, _PLAIN] if first in ("'", '"') else [_PLAIN]:
            if found := form.match(self.text, self.at):
                self.at = found.end()
                return

    def _items(self, key: Key, depth: int, end: str) -> None:
        """Read a list or an inline table from behind its bracket to the one that ends it."""
        count = 0
        while True:
            self._skip(_SPACE)
            if self.text.startswith(end, self.at):
                self.at += 1
                return
            if self.at >= len(self.text):
                raise _Malformed
            if end == "]":
                self._tell((*key, count))
                self._value((*key, count), depth + 1)
            else:
                name = self._key()
                for k in range(1, len(name) + 1):
                    self._tell(key + name[:k])
                self._expect("=")
                self._value(key + name, depth + 1)
            count += 1
            self._skip(_SPACE)
            if not self.text.startswith(end, self.at):
                self._expect(",")

    def _skip(self, form: re.Pattern[str]) -> int:
        while (found := form.match(self.text, self.at)) and found.end() > self.at:
            self.at = found.end()
        return self.at

    def _expect(self, mark: str) -> None:
        self._skip(_BLANK)
        if not self.text.startswith(mark, self.at):
            raise _Malformed
        self.at += len(mark)

    def _here(self) -> int:
        self._line += self.text.count("\n", self._counted, self.at)
        self._counted = self.at
        return self._line

    def _tell(self, key: Key) -> None:
        self._left -= 1
        if self._left < 0:
            raise TooMuch(
                f"more than {MOST_PLACES} keys and entries of lists, with those of includes: give fewer",
                self._here(),
            )
        self.lines.setdefault(key, self._here())

    def _too_deep(self) -> TooMuch:
        return TooMuch(
            f"more than {DEEPEST} lists, tables or words of a dotted key lie inside each other: write it flatter",
            self._here(),
        )
