"""Small maps on a server."""

from __future__ import annotations

from map_cases import make_building, make_model

from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.writing.database import FleetDatabase


def fill(address: MilvusAddress, order: tuple[str, ...] = ("a", "b")) -> None:
    """A map with the buildings of `map_cases.make_map`, added in some order."""
    model = make_model()
    with FleetDatabase.create(address, model) as database:
        for name in order:
            if name == "a":
                database.add_building("a", *make_building(model, 7, 2))
            else:
                database.add_building("b", *make_building(model, 12, 1), source="b.json", frame_id="b_map", stamp_ns=-5)
