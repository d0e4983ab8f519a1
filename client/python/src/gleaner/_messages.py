"""Conversion of plain Python values to messages, and of enum values to words.

A choice is `PRESET_TINY` on the wire and `"tiny"` here, as on the command line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from google.protobuf.descriptor import EnumDescriptor, FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.struct_pb2 import Struct

from gleaner.errors import invalid

M = TypeVar("M", bound=Message)


def build(kind: type[M], values: Mapping[str, Any]) -> M:
    """A message from a mapping: enum values as words, messages as mappings, `None` as unset."""
    return kind(**_plain(kind.DESCRIPTOR, values, ""))


def word(message: Message, field: str) -> str:
    """The word for a message's enum value, for example `word(episode, "outcome")` is `"success"`."""
    descriptor = _enum(message, field)
    number = getattr(message, field)
    value = descriptor.values_by_number.get(number)
    return str(number) if value is None else _word(descriptor, value.name)


def number(kind: type[Message], field: str, text: str) -> Any:
    """The enum value of a word."""
    return _choice(_enum(kind, field), text, field)


def _enum(message: Message | type[Message], field: str) -> Any:
    return message.DESCRIPTOR.fields_by_name[field].enum_type


def _plain(descriptor: Any, values: Mapping[str, Any], path: str) -> dict[str, Any]:
    plain = {}
    for name, value in values.items():
        field = descriptor.fields_by_name.get(name)
        if field is None:
            raise invalid(path + name, f"is unknown; supported: {', '.join(sorted(descriptor.fields_by_name))}")
        if isinstance(value, (list, tuple)) and f"{name}_each" in descriptor.fields_by_name:
            # One for each value, in place of one for all: the bounds of a task's action.
            field = descriptor.fields_by_name[f"{name}_each"]
        if value is not None:
            plain[field.name] = _value(field, value, path + name)
    return plain


def _value(field: FieldDescriptor, value: Any, path: str) -> Any:
    if isinstance(value, (list, tuple)):
        return [_value(field, item, f"{path}[{index}]") for index, item in enumerate(value)]
    if field.enum_type is not None and isinstance(value, str):
        return _choice(field.enum_type, value, path)
    if field.message_type is not None and isinstance(value, Mapping):
        if field.message_type.full_name == Struct.DESCRIPTOR.full_name:
            return _struct(value, f"{path}.")
        return _plain(field.message_type, value, f"{path}.")
    return value


def _struct(values: Mapping[str, Any], path: str) -> Struct:
    struct = Struct()
    for name, value in values.items():
        try:
            struct.update({name: _json(value)})
        except (TypeError, ValueError):
            raise invalid(path + name, f"{value!r} is no number, text, flag or list of them") from None
    return struct


def _json(value: Any) -> Any:
    """A value as JSON has it; numbers and arrays of numpy become those of Python."""
    if isinstance(value, (list, tuple, set)):
        return [_json(item) for item in value]
    plain: Callable[[], Any] | None = getattr(value, "tolist", None)
    return plain() if callable(plain) else value


def _choice(descriptor: EnumDescriptor, text: str, path: str) -> int:
    words = {_word(descriptor, value.name): value.number for value in descriptor.values if value.number != 0}
    if text not in words:
        raise invalid(path, f"{text!r} is unknown; supported: {', '.join(words)}")
    return words[text]


def _word(descriptor: EnumDescriptor, name: str) -> str:
    prefix = descriptor.values[0].name.removesuffix("UNSPECIFIED")
    return name.removeprefix(prefix).lower()
