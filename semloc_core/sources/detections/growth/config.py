"""Options of the graph that detections become."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from semloc_core.config import Checked


class BuilderConfig(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of `GraphBuilder`; make one with `of`, which checks ranges."""

    min_score: Annotated[
        float, Meta(ge=0.0, le=1.0, description="detections whose best class scores lower are left out")
    ] = 0.3
    association_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="a detection so near an object may be of it, m; large ones reach out")
    ] = 0.6
    confirm_after: Annotated[int, Meta(ge=1, le=1000, description="sightings after which an object is published")] = 2
    forget_after: Annotated[
        int, Meta(ge=1, le=100000, description="an object is forgotten when looked at so often in a row and not seen")
    ] = 10
    range_m: Annotated[
        float, Meta(gt=0.0, le=1000.0, description="how far the detector sees: what is nearer counts as looked at, m")
    ] = 4.0
    horizontal_fov_deg: Annotated[
        float, Meta(gt=0.0, le=360.0, description="what counts as looked at: width of the field of view, degrees")
    ] = 60.0
    vertical_fov_deg: Annotated[
        float, Meta(gt=0.0, le=180.0, description="what counts as looked at: height of the field of view, degrees")
    ] = 40.0
    place_spacing_m: Annotated[float, Meta(ge=0.1, le=100.0, description="distance between places, m")] = 0.6
    robot_radius_m: Annotated[
        float, Meta(gt=0.0, le=10.0, description="radius of the robot: where it fits there may be places, m")
    ] = 0.25
    full_every_s: Annotated[
        float, Meta(ge=0.0, le=3600.0, description="seconds between full updates; 0: each update is full")
    ] = 5.0
