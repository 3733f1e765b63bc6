"""Verification by layout: whether the objects around the robot lie as they do around a place of the map.

An embedding says which places are alike; many are. What tells them apart is how the objects lie to one another, and
what room there is between them. So the likeliest places are put to the test, as geometric verification does in visual
place recognition: the robot's surroundings are turned (gravity is known, heading is not) and shifted until they fit the
map's best, and a log-likelihood ratio says how well they do: objects found where the map has them, objects
not found where the robot has looked, room where the map has none.

`LayoutVerifier` does it: coarse (`coarse`, every place of the map), vote for a heading (`vote`), align and score
(`align`). numpy only.
"""

from semloc_core.matching.layout.building.layout import LayoutPart
from semloc_core.matching.layout.config import LayoutConfig
from semloc_core.matching.layout.fragment import Fragment, fragment_of_arrays, fragment_of_graph
from semloc_core.matching.layout.map_layout import MappedLayout
from semloc_core.matching.layout.verifier import LayoutVerifier, Verified

__all__ = [
    "Fragment",
    "LayoutConfig",
    "LayoutPart",
    "LayoutVerifier",
    "MappedLayout",
    "Verified",
    "fragment_of_arrays",
    "fragment_of_graph",
]
