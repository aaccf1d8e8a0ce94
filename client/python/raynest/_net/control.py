"""Control messages: one FlatBuffers table each, to and from dicts.

The flatbuffers package is not used, so that the client needs numpy only: writing takes a page of
code, and received messages must be checked here anyway, because FlatBuffers has no verifier in
Python. Offsets are checked against the message's size, depth and number of tables against their
limits, and texts for control characters. A message that passes is a dict with every field of the
schema: absent numbers have their defaults, absent texts are "", absent lists [], absent tables and
structs None.

    vtable  u16 bytes of the vtable, u16 bytes of the table, u16 offset of each field (0: absent)
    table   i32 back to its vtable, then its fields: scalars and structs, u32 forward to all else
    vector  u32 count, then its items; a string is one of bytes, and a zero behind them
    buffer  u32 forward to the message's table, then the above in any order, all of it aligned
"""
from __future__ import annotations

import functools
import re
import reprlib
import struct
from typing import Any, Mapping, NamedTuple, Optional

import numpy as np

from .. import _limits
from ..errors import ProtocolError, UsageError
from .schema import SCALARS, SCHEMA, Field

Message = dict[str, Any]

_OFFSET = "<I"
_TRUTHS = {bool, np.bool_}


# ---- writing ------------------------------------------------------------------------------------

def encode(name: str, values: Mapping[str, Any]) -> bytes:
    """Writes the table `name` with these fields; others are absent. Structs are tuples, tables
    dicts. A value that does not fit its field raises a UsageError with the field's name, which is
    mostly also the name of the user's argument."""
    out = bytearray(4)
    struct.pack_into("<I", out, 0, _write_table(out, name, values))
    if len(out) > _limits.control_bytes_max:
        raise UsageError(f"a {name} of {len(out)} bytes: it may have {_limits.control_bytes_max}; "
                         "pass shorter texts and lists")
    return bytes(out)


class _Layout(NamedTuple):
    """A table with certain fields, as it is written."""

    vtable: bytes
    table: bytes  # zeros but for the way back to the vtable
    places: tuple[tuple[Field, int, struct.Struct, bool, bool], ...]    # the last two: a struct, inline


@functools.lru_cache(maxsize=1024)
def _layout(name: str, present: tuple[str, ...]) -> _Layout:
    fields = SCHEMA.tables[name]
    unknown = set(present) - {field.name for field in fields}
    if unknown:
        raise KeyError(f"{name} has no field {sorted(unknown)}")
    slots = [(slot, field, _format(field)) for slot, field in enumerate(fields) if field.name in present]
    # Large fields first: if the first one, 4 bytes into the table, is aligned, so are all others.
    slots.sort(key=lambda item: -_alignment(item[2]))
    offsets, end, places = [0] * len(fields), 4, []
    for slot, field, form in slots:
        offsets[slot] = end
        is_struct = field.type in SCHEMA.structs and not field.many
        places.append((field, end, struct.Struct(form), is_struct, field.type in SCALARS and not field.many))
        end += places[-1][2].size
    vtable = struct.pack(f"<{2 + len(fields)}H", 4 + 2 * len(fields), end, *offsets)
    return _Layout(vtable, struct.pack("<i", len(vtable)) + bytes(end - 4), tuple(places))


def _write_table(out: bytearray, name: str, values: Mapping[str, Any]) -> int:
    """Appends the table and everything it refers to; returns its place."""
    layout = _layout(name, tuple([key for key, value in values.items() if value is not None]))
    _align(out, 8, len(layout.vtable) + 4)
    out += layout.vtable
    at = len(out)
    out += layout.table
    for field, offset, form, is_struct, inline in layout.places:
        place, value = at + offset, values[field.name]
        try:
            if is_struct:
                form.pack_into(out, place, *value)
            else:
                if type(value) in _TRUTHS and field.type != "bool":     # which struct takes for 1
                    raise TypeError
                form.pack_into(out, place, value if inline else _write_outside(out, field, value) - place)
        except UsageError:  # about a table within
            raise
        except (struct.error, AttributeError, OverflowError, TypeError, ValueError):
            raise UsageError(f"{field.name} of {reprlib.repr(value)}: it must be "
                             f"{_wanted(field)}") from None
    return at


def _wanted(field: Field) -> str:
    letter = SCALARS.get(field.type, "")
    if letter in ("f", "d"):
        item = "a number of 32 bits" if letter == "f" else "a number"
    elif letter:
        bits = 8 * struct.calcsize(letter)
        item = f"a whole number from 0 to {2**bits - 1}"
    else:
        item = "a text" if field.type == "string" else f"a {field.type}"
    return f"a list, each item {item}" if field.many else item


def _format(field: Field) -> str:
    """The struct format of a field within its table."""
    return _OFFSET if field.many else _item_format(field.type)


@functools.lru_cache(maxsize=None)
def _item_format(kind: str) -> str:
    """The struct format of a vector's item."""
    if kind in SCHEMA.structs:
        return "<" + "".join(SCALARS[item.type] for item in SCHEMA.structs[kind])
    return "<" + SCALARS[kind] if kind in SCALARS else _OFFSET


def _alignment(form: str) -> int:
    return struct.calcsize(form[:2])


def _align(out: bytearray, alignment: int, ahead: int = 0) -> None:
    """Appends zeros until the place `ahead` bytes further on is aligned."""
    out += bytes(-(len(out) + ahead) % alignment)


def _write_outside(out: bytearray, field: Field, value: Any) -> int:
    """Appends a field's target; returns its place."""
    if not field.many:
        return _write_item(out, field.type, value)
    form = _item_format(field.type)
    _align(out, max(4, _alignment(form)), 4)
    at = len(out)
    out += struct.pack("<I", len(value))
    if field.type in SCALARS:
        out += struct.pack(f"<{len(value)}{form[1:]}", *value)
        return at
    if field.type in SCHEMA.structs:
        out += b"".join(struct.pack(form, *item) for item in value)
        return at
    out += bytes(4 * len(value))
    for place, item in zip(range(at + 4, len(out), 4), value):
        struct.pack_into("<I", out, place, _write_item(out, field.type, item) - place)
    return at


def _write_item(out: bytearray, kind: str, value: Any) -> int:
    if kind != "string":
        return _write_table(out, kind, value)
    data = value.encode("utf-8")
    _align(out, 4)
    at = len(out)
    out += struct.pack("<I", len(data)) + data + b"\0"
    return at


# ---- reading ------------------------------------------------------------------------------------

_CONTROL_CHARACTER = re.compile("[\x00-\x1f\x7f-\x9f]")


def decode(name: str, data: bytes) -> Message:
    """Reads the table `name`; ProtocolError for anything that does not fit."""
    reader = _Reader(data)
    return reader.table(name, reader.follow(0), 1)


class _Shape(NamedTuple):
    """A table with a certain vtable, as it is read. Most messages of a kind have one or two."""

    absent: Message
    lists: tuple[str, ...]  # absent ones
    present: tuple[tuple[Field, int, Optional[struct.Struct], bool], ...]  # no form: outside; the last: a struct


@functools.lru_cache(maxsize=1024)
def _shape(name: str, table_bytes: int, offsets: bytes) -> _Shape:
    fields = SCHEMA.tables[name]
    slots = len(offsets) // 2
    absent: Message = {}
    lists, present = [], []
    for field, offset in zip(fields, (*struct.unpack(f"<{slots}H", offsets), *(0,) * (len(fields) - slots))):
        if offset >= max(table_bytes, 1):
            raise ProtocolError(f"the daemon sent {name}.{field.name} outside of its table")
        absent[field.name] = None if offset else _absent(name, field)
        if offset:
            is_struct = field.type in SCHEMA.structs
            is_inline = not field.many and (is_struct or field.type in SCALARS)
            present.append((field, offset, struct.Struct(_format(field)) if is_inline else None, is_struct))
        elif field.many:
            lists.append(field.name)
    return _Shape(absent, tuple(lists), tuple(present))


def _absent(name: str, field: Field) -> Any:
    if field.required:
        raise ProtocolError(f"the daemon sent a {name} without {field.name}")
    if field.type in SCALARS:
        return bool(field.default) if field.type == "bool" else field.default
    return "" if field.type == "string" else None


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._tables = 0
        self._left = _limits.control_bytes_max  # for texts and lists

    def table(self, name: str, at: int, depth: int) -> Message:
        self._tables += 1
        if depth > _limits.control_depth_max or self._tables > _limits.control_tables_max:
            raise ProtocolError("the daemon sent a message with too many tables")
        vtable = at - self._number("i", at)
        vtable_bytes, table_bytes = self._numbers("<HH", vtable)
        size = 2 * min(max(vtable_bytes // 2 - 2, 0), len(SCHEMA.tables[name]))
        self._check(vtable + 4, size)
        shape = _shape(name, table_bytes, bytes(self._data[vtable + 4:vtable + 4 + size]))
        message = shape.absent.copy()
        for each in shape.lists:
            message[each] = []
        for field, offset, form, is_struct in shape.present:
            if form is None:
                target = self.follow(at + offset)
                message[field.name] = (self._list(field, target, depth) if field.many
                                       else self._item(field.type, target, depth))
                continue
            try:
                value = form.unpack_from(self._data, at + offset)
            except struct.error:
                raise _outside() from None
            message[field.name] = value if is_struct else value[0]
        return message

    def _list(self, field: Field, at: int, depth: int) -> list[Any]:
        count = self._number("I", at)
        form = _item_format(field.type)
        size = struct.calcsize(form)
        self._take(at + 4, count * size)
        if field.type in SCALARS:
            return list(struct.unpack_from(f"<{count}{form[1:]}", self._data, at + 4))
        if field.type in SCHEMA.structs:
            return list(struct.iter_unpack(form, self._data[at + 4:at + 4 + count * size]))
        return [self._item(field.type, self.follow(at + 4 + 4 * i), depth) for i in range(count)]

    def _item(self, kind: str, at: int, depth: int) -> Any:
        if kind != "string":
            return self.table(kind, at, depth + 1)
        count = self._number("I", at)
        self._take(at + 4, count)
        try:
            text = self._data[at + 4:at + 4 + count].decode("utf-8")
        except UnicodeDecodeError:
            raise ProtocolError("the daemon sent a text that is not UTF-8") from None
        if _CONTROL_CHARACTER.search(text):
            raise ProtocolError("the daemon sent a text with control characters")
        return text

    def _take(self, at: int, size: int) -> None:
        """Checks a text or list. Offsets may name one many times, each of which costs memory here."""
        self._check(at, size)
        self._left -= size
        if self._left < 0:
            raise ProtocolError("the daemon sent a message that repeats its texts or lists")

    def follow(self, at: int) -> int:
        return at + int(self._number("I", at))

    def _number(self, letter: str, at: int) -> Any:
        return self._numbers("<" + letter, at)[0]

    def _numbers(self, letters: str, at: int) -> tuple[Any, ...]:
        self._check(at, 0)
        try:
            return struct.unpack_from(letters, self._data, at)
        except struct.error:
            raise _outside() from None

    def _check(self, at: int, size: int) -> None:
        if at < 0 or at + size > len(self._data):
            raise _outside()


def _outside() -> ProtocolError:
    return ProtocolError("the daemon sent a message that points outside of itself")
