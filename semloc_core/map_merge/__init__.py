"""Maps that live: a later traversal merges into a building that the map has."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.map_merge.config import MergeConfig
    from semloc_core.map_merge.edit import store_edited, with_places, without_places
    from semloc_core.map_merge.merging import Merged, merge
    from semloc_core.map_merge.sides import Side
    from semloc_core.map_merge.store import embed_again, map_weights, merge_into, propose, put_building, side, undo
    from semloc_core.map_merge.transform import Transform, fit_transform
else:
    __getattr__ = exports(__name__)

__all__ = [
    "MergeConfig", "Merged", "Side", "Transform", "embed_again", "fit_transform", "map_weights", "merge", "merge_into",
    "propose", "put_building", "side", "store_edited", "undo", "with_places", "without_places",
]  # fmt: skip
