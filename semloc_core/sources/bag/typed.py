"""A bag's messages as objects with fields, by the definitions that the bag itself has; vision_msgs' stand here too."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from semloc_core.errors import BagError
from semloc_core.sources.bag.reader import BagMessage, BagReader

DETECTIONS = "vision_msgs/msg/Detection3DArray"
ODOMETRY = "nav_msgs/msg/Odometry"
GRID = "nav_msgs/msg/OccupancyGrid"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
# vision_msgs 4 (Apache-2.0), which ROS 2 Jazzy has but not among its own packages.
_VISION = {
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections\n",
    "Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id\n",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
}


@functools.lru_cache(maxsize=1)
def typestore() -> Any:
    """What ROS 2 Jazzy ships, and vision_msgs."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _VISION.items():
        store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
    return store


class TypedMessages:
    """Decodes a bag's messages.

    Args:
        reader: of the bag; it has met the messages that are decoded.
        fallback: type -> its definition, where the bag has none and ROS 2 Jazzy neither.

    """

    def __init__(self, reader: BagReader, fallback: Mapping[str, str] | None = None) -> None:
        self._reader, self._fallback = reader, fallback or {}
        self._stores: dict[str, Any] = {}

    def decode(self, message: BagMessage) -> Any:
        """A message with the fields of its type.

        Raises:
            BagError: the definition or the message is broken.

        """
        try:
            store = self._stores.get(message.topic)
            if store is None:
                store = self._stores[message.topic] = self._store(message)
            return store.deserialize_cdr(message.data, message.type)
        except Exception as error:
            # rosbags' own errors, and whatever a broken definition or payload leads to.
            reason = " ".join(str(error).split())[:120] or type(error).__name__
            raise BagError(f"expected a {message.type} (got: {reason})") from error

    def _store(self, message: BagMessage) -> Any:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        text = self._reader.definitions.get(message.topic) or self._fallback.get(message.type)
        if not text:
            return typestore()
        store = get_typestore(Stores.ROS2_JAZZY)
        known = store.fielddefs
        store.register({name: of for name, of in get_types_from_msg(text, message.type).items() if name not in known})
        return store
