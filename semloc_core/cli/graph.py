"""``semloc graph``: scene graphs out of what a robot without Hydra has."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from semloc_core.cli.shared.common import LabelspaceOption, RobotOption, SynonymsOption, TopicOption, console, tell
from semloc_core.cli.shared.outputs import App, Writes
from semloc_core.cli.shared.screen import many, note
from semloc_core.cli.shared.words import within
from semloc_core.errors import BagError, FileFormatError
from semloc_core.files import BAG, GRAPH, Output
from semloc_core.sources import BuilderConfig

if TYPE_CHECKING:
    from semloc_core.graph import SceneGraph

app = App(no_args_is_help=True, help="Make scene graphs of detections, or of a nav2 map and a list of objects.")
DEFAULTS = BuilderConfig()
Spacing = Annotated[float, typer.Option("--spacing", min=0.1, max=100.0, help="Distance between places, m.")]
Radius = Annotated[float, typer.Option("--radius", min=0.01, max=10.0, help="Radius of the robot, m.")]


def _stream() -> type:
    from semloc_core.sources import StreamConfig

    return StreamConfig


_builder = partial(within, _stream)


class GraphOrRun(Writes):
    """A graph where the name ends in .json, else a bag."""

    def outputs(self, name: str, value: Any, values: dict[str, Any]) -> Iterator[Output]:
        """What a value makes the command write."""
        yield Output(name, Path(value), self.kind if Path(value).suffix == ".json" else BAG)


def _write(path: Path, graph: SceneGraph) -> None:
    from semloc_core.graph import labelspace_from_hydra
    from semloc_core.sources import write_hydra

    classes = sorted({thing.class_ for thing in graph.objects.values()})
    write_hydra(path, graph, labelspace_from_hydra(path.name, enumerate(classes), ()))
    console.print(f"{path}: {many(len(graph.places), 'place')}, {many(len(graph.objects), 'object')}")


@app.command("from-nav2")
def from_nav2(
    map_file: Annotated[Path, typer.Argument(metavar="MAP.yaml", help="The map, as nav2's map_server reads it.")],
    objects: Annotated[
        Path,
        typer.Argument(
            metavar="OBJECTS", help="CSV, YAML or JSON: class, x, y, z and perhaps size, in the map's frame."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="GRAPH", parser=Writes(GRAPH), help="Where to write the graph (JSON)."),
    ],
    spacing: Spacing = DEFAULTS.place_spacing_m,
    radius: Radius = DEFAULTS.robot_radius_m,
) -> None:
    """Make a graph of a saved occupancy grid and a list of objects, in the grid's own frame.

    Places stand over free space where the robot fits, edges cross no wall; so what semloc says is in AMCL's frame.
    """
    from semloc_core.sources import graph_of_grid, read_nav2, read_objects

    grid, listed = read_nav2(map_file), read_objects(objects)
    graph, left = graph_of_grid(grid, listed, spacing_m=spacing, radius_m=radius)
    for i in left[:8]:
        class_, (x, y, _), _ = listed[i]
        note(f"{objects}: {class_} at {x:g}, {y:g} is too far from free space and left out")
    if len(left) > 8:
        note(f"{objects}: {len(left)} objects are too far from free space and left out")
    if listed and len(left) == len(listed):
        raise FileFormatError(
            f"expected objects of {objects} near free space of {map_file} (got none of {len(listed)}: are both in one "
            "frame?)"
        )
    _write(output, graph)


@app.command("from-detections")
def from_detections(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A bag with detections and odometry or transforms.")],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="GRAPH|RUN",
            parser=GraphOrRun(GRAPH),
            help="The graph at the end (.json), or the run of updates (.mcap, or a folder).",
        ),
    ],
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    topic: TopicOption = None,
    robot: RobotOption = None,
    frame: Annotated[str, typer.Option(help="Frame of the graph; default: odometry's.")] = "",
    robot_frame: Annotated[str, typer.Option(help="Frame of the robot; default: odometry's child.")] = "",
    confirm_after: Annotated[
        int, typer.Option(help="Sightings after which an object counts.", callback=_builder("confirm_after"))
    ] = DEFAULTS.confirm_after,
    forget_after: Annotated[
        int,
        typer.Option(
            help="Looks in a row without it after which an object is gone.", callback=_builder("forget_after")
        ),
    ] = DEFAULTS.forget_after,
    min_score: Annotated[
        float, typer.Option(help="Detections that score lower are left out.", callback=_builder("min_score"))
    ] = DEFAULTS.min_score,
    range_m: Annotated[
        float, typer.Option("--range", help="How far the detector sees, m.", callback=_builder("range_m"))
    ] = DEFAULTS.range_m,
    spacing: Spacing = DEFAULTS.place_spacing_m,
    radius: Radius = DEFAULTS.robot_radius_m,
) -> None:
    """Make a graph, or a run of updates, of a recorded run of 3D detections and odometry.

    It reads vision_msgs/Detection3DArray, nav_msgs/Odometry or transforms, and perhaps a nav_msgs/OccupancyGrid.
    """
    from semloc_core.graph import Reading
    from semloc_core.sources import DETECTIONS as WANTED
    from semloc_core.sources import Run, StreamConfig, graph_at_end, write_updates

    config = StreamConfig.of(
        frame_id=frame,
        robot_frame=robot_frame,
        confirm_after=confirm_after,
        forget_after=forget_after,
        min_score=min_score,
        range_m=range_m,
        place_spacing_m=spacing,
        robot_radius_m=radius,
    )
    reading = Reading.of(labelspace, synonyms, topic=topic, robot=robot)
    found = Run(run, topic=topic, robot=robot, detections=config)
    if found.type != WANTED:
        raise BagError(f"expected detections ({WANTED}) in {run} (got updates on {found.topic or 'its lines'})")
    if output.suffix != ".json":
        count = write_updates(output, found)
        console.print(f"{output}: {many(count, 'update')}")
        return
    labels = reading.labels()
    graph = labels.graph(graph_at_end(run, reading=reading, detections=config))
    tell(run, labels.told())
    _write(output, graph)
