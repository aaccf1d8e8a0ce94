"""Control messages: one FlatBuffers table each, to and from dicts.

Writing is left to FlatBuffers' builder. Reading is done here, because what a daemon sends is
checked like everything from outside and FlatBuffers has no verifier in Python: each offset against
the bytes that are there, depth and number of tables against their limits, texts for control
characters. A message that passes is a dict with every field of the schema: absent numbers have
their defaults, absent texts are "", absent lists [], absent tables and structs None.
"""
from __future__ import annotations

import re
import struct
from typing import Any, Mapping

import flatbuffers
from flatbuffers import number_types

from . import _limits
from ._schema import SCALARS, SCHEMA, Field
from .errors import ProtocolError

Message = dict[str, Any]

_FLAGS = {"bool": number_types.BoolFlags, "ubyte": number_types.Uint8Flags,
          "ushort": number_types.Uint16Flags, "uint": number_types.Uint32Flags,
          "ulong": number_types.Uint64Flags, "byte": number_types.Int8Flags,
          "short": number_types.Int16Flags, "int": number_types.Int32Flags,
          "long": number_types.Int64Flags, "float": number_types.Float32Flags,
          "double": number_types.Float64Flags}


# ---- writing --------------------------------------------------------------------------------------

def encode(name: str, values: Mapping[str, Any]) -> bytes:
    """The table `name` with these fields; others are absent. Structs are tuples, tables dicts."""
    builder = flatbuffers.Builder(256)
    builder.Finish(_write_table(builder, name, values))
    return bytes(builder.Output())


def _write_table(builder: Any, name: str, values: Mapping[str, Any]) -> int:
    fields = SCHEMA.tables[name]
    unknown = values.keys() - {field.name for field in fields}
    if unknown:
        raise KeyError(f"{name} has no field {sorted(unknown)}")
    # What lies outside of the table comes first; structs and scalars lie within it.
    outside = {field.name: _write_outside(builder, field, values[field.name]) for field in fields
               if values.get(field.name) is not None and not _inline(field)}
    builder.StartObject(len(fields))
    for slot, field in enumerate(fields):
        value = values.get(field.name)
        if field.name in outside:
            builder.PrependUOffsetTRelativeSlot(slot, outside[field.name], 0)
        elif value is not None and field.type in SCALARS:
            builder.PrependSlot(_FLAGS[field.type], slot, value, field.default)
        elif value is not None:
            builder.PrependStructSlot(slot, _write_struct(builder, field.type, value), 0)
    return int(builder.EndObject())


def _inline(field: Field) -> bool:
    return not field.many and (field.type in SCALARS or field.type in SCHEMA.structs)


def _write_outside(builder: Any, field: Field, value: Any) -> int:
    if not field.many:
        return _write_item(builder, field.type, value)
    if field.type in SCALARS:
        size = struct.calcsize(SCALARS[field.type])
        builder.StartVector(size, len(value), size)
        for item in reversed(value):
            builder.Prepend(_FLAGS[field.type], item)
    else:
        items = [_write_item(builder, field.type, item) for item in value]
        builder.StartVector(4, len(items), 4)
        for item in reversed(items):
            builder.PrependUOffsetTRelative(item)
    return int(builder.EndVector())


def _write_item(builder: Any, kind: str, value: Any) -> int:
    if kind == "string":
        return int(builder.CreateString(value))
    return _write_table(builder, kind, value)


def _write_struct(builder: Any, kind: str, values: tuple[float, ...]) -> int:
    fields = SCHEMA.structs[kind]
    sizes = [struct.calcsize(SCALARS[field.type]) for field in fields]
    builder.Prep(max(sizes), sum(sizes))
    for field, value in zip(reversed(fields), reversed(values)):
        builder.Prepend(_FLAGS[field.type], value)
    return int(builder.Offset())


# ---- reading --------------------------------------------------------------------------------------

_CONTROL_CHARACTER = re.compile("[\x00-\x1f\x7f-\x9f]")


def decode(name: str, data: bytes) -> Message:
    """Reads the table `name`; ProtocolError for anything that does not fit."""
    reader = _Reader(data)
    return reader.table(name, reader.follow(0), 1)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._tables = 0

    def table(self, name: str, at: int, depth: int) -> Message:
        self._tables += 1
        if depth > _limits.control_depth_max or self._tables > _limits.control_tables_max:
            raise ProtocolError("the daemon sent a message with too many tables")
        vtable = at - self._number("i", at)
        vtable_bytes, table_bytes = self._number("H", vtable), self._number("H", vtable + 2)
        message: Message = {}
        for index, field in enumerate(SCHEMA.tables[name]):
            slot = 4 + 2 * index
            offset = self._number("H", vtable + slot) if slot + 2 <= vtable_bytes else 0
            if offset >= max(table_bytes, 1):
                raise ProtocolError(f"the daemon sent {name}.{field.name} outside of its table")
            message[field.name] = (self._value(field, at + offset, depth) if offset
                                   else self._absent(name, field))
        return message

    @staticmethod
    def _absent(name: str, field: Field) -> Any:
        if field.required:
            raise ProtocolError(f"the daemon sent a {name} without {field.name}")
        if field.many:
            return []
        if field.type in SCALARS:
            return bool(field.default) if field.type == "bool" else field.default
        return "" if field.type == "string" else None

    def _value(self, field: Field, at: int, depth: int) -> Any:
        if field.many:
            return self._list(field, self.follow(at), depth)
        if field.type in SCALARS:
            return self._number(SCALARS[field.type], at)
        if field.type in SCHEMA.structs:
            letters = "".join(SCALARS[item.type] for item in SCHEMA.structs[field.type])
            return self._numbers("<" + letters, at)
        return self._item(field.type, self.follow(at), depth)

    def _list(self, field: Field, at: int, depth: int) -> list[Any]:
        count = self._number("I", at)
        if field.type in SCALARS:
            self._check(at + 4, count * struct.calcsize("<" + SCALARS[field.type]))
            return list(struct.unpack_from(f"<{count}{SCALARS[field.type]}", self._data, at + 4))
        self._check(at + 4, count * 4)
        return [self._item(field.type, self.follow(at + 4 + 4 * i), depth) for i in range(count)]

    def _item(self, kind: str, at: int, depth: int) -> Any:
        if kind != "string":
            return self.table(kind, at, depth + 1)
        count = self._number("I", at)
        self._check(at + 4, count)
        try:
            text = self._data[at + 4:at + 4 + count].decode("utf-8")
        except UnicodeDecodeError:
            raise ProtocolError("the daemon sent a text that is not UTF-8") from None
        if _CONTROL_CHARACTER.search(text):
            raise ProtocolError("the daemon sent a text with control characters")
        return text

    def follow(self, at: int) -> int:
        return at + int(self._number("I", at))

    def _number(self, letter: str, at: int) -> Any:
        return self._numbers("<" + letter, at)[0]

    def _numbers(self, letters: str, at: int) -> tuple[Any, ...]:
        self._check(at, struct.calcsize(letters))
        return struct.unpack_from(letters, self._data, at)

    def _check(self, at: int, size: int) -> None:
        if at < 0 or at + size > len(self._data):
            raise ProtocolError("the daemon sent a message that points outside of itself")
