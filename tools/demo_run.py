"""Makes the demo's buildings and its run, all simulated: ``python tools/demo_run.py FOLDER``.

The run has what is hard in it: it starts in the dark (the robot sees two metres far), is carried elsewhere twice,
once into a twin of the office that has half of its furniture, and ends in a building that no map has.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from semloc_core.graph import SceneGraph
from semloc_core.map_database import load
from semloc_core.sources import (
    OfficeConfig,
    SimulationConfig,
    Step,
    make_office,
    simulate_traversal,
    write_hydra,
    write_run,
)

OFFICE, TWIN, FOREIGN = "office", "twin", "foreign"


def buildings() -> dict[str, SceneGraph]:
    """The shipped office, its twin with every second object gone, and an office that is in no map."""
    office = load("models/office.map").graph(OFFICE)
    update = office.to_update(0, 0, TWIN)
    kept = [thing for i, thing in enumerate(update.objects) if i % 2]
    gone = {thing.id for thing in update.objects} - {thing.id for thing in kept}
    edges = [edge for edge in update.edges if not gone & set(edge)]
    sightings = [pair for pair in update.sightings if pair[1] not in gone]
    twin = SceneGraph.from_update(msgspec.structs.replace(update, objects=kept, edges=edges, sightings=sightings))
    world = make_office(OfficeConfig(), np.random.default_rng(7))
    return {OFFICE: office, TWIN: twin, FOREIGN: world.graph}


def walked(graphs: dict[str, SceneGraph]) -> Iterator[Step]:
    """The four parts, one after the other."""
    parts = [(OFFICE, 2.0, 6.0), (OFFICE, 8.0, 12.0), (TWIN, 8.0, 12.0), (FOREIGN, 8.0, 12.0)]
    stamp_ns = 0
    for seed, (name, range_m, distance_m) in enumerate(parts):
        config = SimulationConfig.of(
            range_m=range_m, distance_m=distance_m, frame_id=name, start_stamp_ns=stamp_ns, shared_frame=True
        )
        for step in simulate_traversal(graphs[name], config, np.random.default_rng(seed)):
            stamp_ns = step.update.stamp_ns + 500_000_000
            yield step


def main() -> None:
    """Write the buildings that are mapped, and the run."""
    folder, graphs = Path(sys.argv[1]), buildings()
    for name in (OFFICE, TWIN):
        write_hydra(folder / f"{name}.json", graphs[name], load("models/office.map").model.labelspace)
    write_run(folder / "run.mcap", walked(graphs))


if __name__ == "__main__":
    main()
