"""Maps that live: a later traversal merges into a building that the map has."""

from semloc_core.map_merge.config import MergeConfig
from semloc_core.map_merge.merging import Merged, merge
from semloc_core.map_merge.sides import Side
from semloc_core.map_merge.store import merge_into, propose, undo

__all__ = ["MergeConfig", "Merged", "Side", "merge", "merge_into", "propose", "undo"]
