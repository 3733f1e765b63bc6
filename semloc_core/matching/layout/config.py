"""What a detector and a mapper do, as far as verification by layout is concerned."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from semloc_core.config import Share

Far = Annotated[float, Meta(gt=0.0, le=100.0)]
Near = Annotated[float, Meta(gt=0.0, le=10.0)]


class LayoutConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of `LayoutVerifier`; the defaults were chosen on perturbed variants of map graphs."""

    reach_m: Annotated[Far, Meta(description="how far from the robot its surroundings count")] = 12.0
    floor_m: Annotated[
        Far, Meta(description="how far above and below the robot: the next floor tells places apart too")
    ] = 3.5
    detected: Annotated[float, Meta(gt=0.0, le=1.0, description="share of the mapped objects that are detected")] = 0.77
    looked: Annotated[
        Share, Meta(description="share of the mapped objects near known places that the robot has looked at")
    ] = 0.5
    invented: Annotated[Near, Meta(description="objects seen for each m² known that the map does not have")] = 0.06
    spread_m: Annotated[Near, Meta(description="standard deviation of an object's position, per axis in the plane")] = (
        0.7
    )
    height_spread_m: Annotated[Near, Meta(description="standard deviation of an object's height above the place")] = 0.7
    off_m: Annotated[Near, Meta(description="standard deviation of the robot from the map's place, per axis")] = 0.5
    seen_within_m: Annotated[Near, Meta(description="objects so near to a known place would have been seen")] = 1.0
    room_within_m: Annotated[
        Near, Meta(description="a known place so near to a place of the map is in its free space")
    ] = 0.9
    room_weight: Annotated[
        float,
        Meta(ge=0.0, le=10.0, description="weight of a known place in walls: places beside one another are not news"),
    ] = 0.25
    voted: Annotated[int, Meta(ge=0, le=100_000, description="places proposed by pairs of objects; 0: none")] = 400
    coarse: Annotated[int, Meta(ge=0, le=100_000, description="places proposed by the scan; 0: none")] = 400
    wide: Annotated[
        int,
        Meta(ge=1, le=1000, description="so many times the poses aligned are looked at for what speaks against them"),
    ] = 8
    fine: Annotated[int, Meta(ge=1, le=10_000, description="poses that are aligned and scored")] = 30
    most_objects: Annotated[
        int, Meta(ge=1, le=10_000, description="objects that count at most, the nearest; bounds the cost of an answer")
    ] = 64
