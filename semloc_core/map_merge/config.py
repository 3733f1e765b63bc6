"""Options of a merge: one source of default, unit, range and description."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from semloc_core.config import Share

Gate = Annotated[float, Meta(gt=0.0, le=10.0)]
Prior = Annotated[float, Meta(gt=0.0, lt=1.0)]


class MergeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a traversal is laid on a building and what it changes; chosen on generated worlds."""

    candidates: Annotated[
        int, Meta(ge=1, le=100, description="objects of the map that an object seen may be, at first")
    ] = 8
    hypotheses: Annotated[
        int, Meta(ge=10, le=100_000, description="pairs of matches that an alignment is tried from")
    ] = 3000
    pair_tolerance_m: Annotated[Gate, Meta(description="by how much two distances of one pair may differ, m")] = 0.7
    gate_low_m: Annotated[Gate, Meta(description="least gate of one and the same object, m")] = 0.5
    gate_high_m: Annotated[Gate, Meta(description="largest gate of one and the same object, m")] = 1.5
    min_objects: Annotated[int, Meta(ge=3, le=1000, description="objects that must agree")] = 5
    min_share: Annotated[
        Share, Meta(description="share of the objects seen where the map has places that must agree")
    ] = 0.25
    min_gain: Annotated[
        float,
        Meta(ge=1.0, le=100.0, description="factor by which the support exceeds that of the traversal's mirror image"),
    ] = 1.4
    max_rival: Annotated[Share, Meta(description="support of another alignment, as a share of the best one's")] = 0.8
    moved_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="standard deviation of x and of y of an object moved, m")
    ] = 2.5
    miss_rate: Annotated[Prior, Meta(description="prior share of objects that a traversal misses")] = 0.25
    new_rate: Annotated[Prior, Meta(description="prior share of objects seen that are no object of the map")] = 0.2
    new_object: Annotated[
        float, Meta(gt=0.0, le=1.0, description="probability that an object is there which earlier traversals lacked")
    ] = 0.5
    forget_below: Annotated[
        float, Meta(ge=0.0, lt=1.0, description="probability below which an object is taken out of the map")
    ] = 0.05
    seed: Annotated[int, Meta(ge=0, description="of the sampling of alignments")] = 0
