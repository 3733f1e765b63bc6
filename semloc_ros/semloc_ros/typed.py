# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Messages of the contract as `semloc_msgs` has them, and back; `semloc_core.wire.ros_types` says what becomes what."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, TypeVar

import msgspec
from std_msgs.msg import String

from semloc_core import wire
from semloc_ros import conversions, qos

S = TypeVar("S", bound=msgspec.Struct)


@cache
def messages() -> ModuleType | None:
    """Where the types are; None where `semloc_msgs` is not installed."""
    try:
        import semloc_msgs.msg
    except ImportError:
        return None
    return semloc_msgs.msg


class Twofold:
    """A topic in JSON, and beside it a typed one (``…_typed``): where its types are installed and somebody listens.

    Args:
        make: makes a publisher of a type, a topic and a quality of service.
        topic: that of the JSON.
        type_: what is published.

    """

    def __init__(self, make: Callable[..., Any], topic: str, type_: type[msgspec.Struct]) -> None:
        self._type, there = type_, messages()
        self._json = make(String, topic, qos.ANSWERS)
        self._typed = make(getattr(there, type_.__name__), f"{topic}_typed", qos.ANSWERS) if there else None

    def publish(self, message: String) -> None:
        """Publish it; what is typed is made of the JSON, so that both say the same to the last digit."""
        self._json.publish(message)
        if self._typed is not None and self._typed.get_subscription_count():
            self._typed.publish(message_of(wire.decode(message.data, self._type)))


def message_of(struct: msgspec.Struct) -> Any:
    """A struct as its message."""
    type_ = type(struct)
    message = getattr(messages(), type_.__name__)()
    if wire.has_header(type_):
        message.header = conversions.header(struct.stamp_ns, struct.frame_id)
    for field in wire.ros_fields(type_):
        value = getattr(struct, field.attribute)
        if field.nullable:
            setattr(message, f"has_{field.name}", value is not None)
        if value is not None:
            setattr(message, field.name, _each(field, _put, value))
    return message


def struct_of(message: Any, type_: type[S]) -> S:
    """The struct that a message is of: the inverse of `message_of`."""
    values: dict[str, Any] = {}
    if wire.has_header(type_):
        values = {"schema": wire.schema_of(type_), "stamp_ns": conversions.stamp_ns(message.header.stamp)}
        values["frame_id"] = message.header.frame_id
    for field in wire.ros_fields(type_):
        there = not field.nullable or getattr(message, f"has_{field.name}")
        values[field.attribute] = _each(field, _take, getattr(message, field.name)) if there else None
    return type_(**values)


def _each(field: wire.RosField, convert: Callable[[wire.RosField, Any], Any], value: Any) -> Any:
    return convert(field, value) if field.length is None else [convert(field, item) for item in value]


def _put(field: wire.RosField, value: Any) -> Any:
    if field.struct is not None:
        return message_of(value)
    return conversions.point(value) if field.is_point else value


def _take(field: wire.RosField, value: Any) -> Any:
    if field.struct is not None:
        return struct_of(value, field.struct)
    return (value.x, value.y, value.z) if field.is_point else value
