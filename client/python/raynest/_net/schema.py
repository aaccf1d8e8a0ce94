"""The tables of protocol/messages.fbs, read from that file itself.

Code that flatc generates is not tracked in this house, and this package runs from the source tree
without a build. So the schema is the one file that daemon, C++ client and this package share
(messages.fbs one folder up is a link to it, a copy once installed): a field that is appended
there is known here. Only what that file uses of the language is understood: tables, structs of
scalars, enums, and the union that numbers the messages.
"""
from __future__ import annotations

import pathlib
import re
from typing import Iterator, NamedTuple, Union

TOKEN = re.compile(r"//[^\n]*|\s+|([A-Za-z_][\w.]*|-?\d[\w.]*|[{}()\[\]:;=,])")

# FlatBuffers' name -> struct's letter.
SCALARS = {"bool": "?", "ubyte": "B", "ushort": "H", "uint": "I", "ulong": "Q",
           "byte": "b", "short": "h", "int": "i", "long": "q", "float": "f", "double": "d"}

Number = Union[int, float]


class Field(NamedTuple):
    name: str
    type: str           # a scalar, "string", or the name of a table or struct
    many: bool          # a vector of it
    default: Number     # for a scalar
    required: bool


class Schema:
    """`tables` and `structs` by name; `types` gives a message's number, `names` the reverse."""

    def __init__(self, text: str) -> None:
        self.tables: dict[str, tuple[Field, ...]] = {}
        self.structs: dict[str, tuple[Field, ...]] = {}
        self.enums: dict[str, dict[str, int]] = {}
        self._underlying: dict[str, str] = {}
        self._words = self._tokens(text)
        for keyword in self._words:
            if keyword == "namespace":
                self._until(";")
            elif keyword in ("table", "struct"):
                self._fields(self.tables if keyword == "table" else self.structs)
            elif keyword in ("enum", "union"):
                self._enumerators()
            else:
                raise ValueError(f"messages.fbs: {keyword!r} is not understood")
        self.types = self.enums["Message"]
        self.names = {number: name for name, number in self.types.items()}

    @staticmethod
    def _tokens(text: str) -> Iterator[str]:
        at = 0
        while at < len(text):
            match = TOKEN.match(text, at)
            if match is None:
                raise ValueError(f"messages.fbs: {text[at:at + 20]!r} is not understood")
            at = match.end()
            if match.group(1):
                yield match.group(1)

    def _until(self, end: str) -> list[str]:
        """Takes and returns the words before `end`; takes `end` as well."""
        return list(iter(self._words.__next__, end))

    def _fields(self, home: dict[str, tuple[Field, ...]]) -> None:
        name = next(self._words)
        self._until("{")
        fields = []
        for field in iter(self._words.__next__, "}"):
            # [":", "[", TYPE, "]", "=", DEFAULT, "(", "required", ")"], most of it optional
            words = self._until(";")
            many = words[1] == "["
            kind = words[2 if many else 1]
            kind = self._underlying.get(kind, kind)
            default = words[words.index("=") + 1] if "=" in words else "0"
            if kind in ("float", "double"):
                default = str(float(default))
            fields.append(Field(field, kind, many, _number(default), "required" in words))
        home[name] = tuple(fields)

    def _enumerators(self) -> None:
        name, *base = self._until("{")
        if base:
            self._underlying[name] = base[1]
        words = [word for word in self._until("}") if word not in "=,"]
        self.enums[name] = {key: int(value) for key, value in zip(words[::2], words[1::2])}


def _number(word: str) -> Number:
    if word in ("true", "false"):
        return int(word == "true")
    return float(word) if "." in word else int(word)


def _text() -> str:
    file = pathlib.Path(__file__).parents[1] / "messages.fbs"
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ImportError(f"raynest: {file} is missing. In the source tree it is a link to "
                          "protocol/messages.fbs: copy client/python with cp -rL, or install it "
                          "with pip") from None


SCHEMA = Schema(_text())
