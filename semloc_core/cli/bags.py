"""``semloc bag``."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.shared.common import (
    LabelspaceOption,
    RobotOption,
    Seed,
    SynonymsOption,
    building_name,
    console,
    note,
    read_graph,
)
from semloc_core.cli.shared.outputs import App, output_option
from semloc_core.cli.shared.words import within
from semloc_core.errors import ConfigError
from semloc_core.files import BAG

app = App(no_args_is_help=True, help="Make bags.")


def _simulation() -> type:
    from semloc_core.sources import SimulationConfig

    return SimulationConfig


def _detections() -> type:
    from semloc_core.sources import DetectorConfig

    return DetectorConfig


_walk, _detector = partial(within, _simulation), partial(within, _detections)


@app.command("simulate")
def simulate(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="The building to walk through.")],
    output: Annotated[Path, output_option("RUN", BAG, "The bag: a .mcap or a folder.")],
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    speed: Annotated[float, typer.Option(help="Walking speed, m/s.", callback=_walk("speed_mps"))] = 0.5,
    distance: Annotated[
        float,
        typer.Option(help="How far to walk, m; agent poses are followed to their end.", callback=_walk("distance_m")),
    ] = 60.0,
    range_m: Annotated[
        float, typer.Option("--range", help="Sensing range along walkable ways, m.", callback=_walk("range_m"))
    ] = 5.0,
    miss_rate: Annotated[
        float | None,
        typer.Option(
            help="Share of the objects that are never detected (0.1).", show_default=False, callback=_walk("miss_rate")
        ),
    ] = None,
    false_rate: Annotated[
        float | None,
        typer.Option(
            help="Invented objects for each true one (0.05).", show_default=False, callback=_walk("false_rate")
        ),
    ] = None,
    position_noise: Annotated[
        float, typer.Option(help="Standard deviation of object positions, m.", callback=_walk("position_noise_m"))
    ] = 0.1,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Updates per second (2), or a camera's frames (4).", show_default=False, callback=_walk("rate_hz")
        ),
    ] = None,
    drift: Annotated[
        float,
        typer.Option(
            help="Drift of the run's frame; 1: 0.5° and 0.03 m per axis, a root metre.", callback=_walk("drift")
        ),
    ] = 0.0,
    detections: Annotated[
        bool,
        typer.Option(
            "--detections",
            help="Record what a 3D detector, odometry and transforms say, for `graph from-detections`; "
            "--miss-rate is then of each frame (0.2), --false-rate 0.02.",
        ),
    ] = False,
    cameras: Annotated[
        int, typer.Option(help="With --detections: cameras, evenly around.", callback=_detector("cameras"))
    ] = 1,
    fov: Annotated[
        float,
        typer.Option(
            help="With --detections: a camera's width of view, degrees.", callback=_detector("horizontal_fov_deg")
        ),
    ] = 90.0,
    confusion_rate: Annotated[
        float,
        typer.Option(
            help="With --detections: chance, in each frame, that another class scores best.",
            callback=_detector("confusion_rate"),
        ),
    ] = 0.1,
    depth_noise: Annotated[
        float,
        typer.Option(
            help="With --detections: deviation of depth at 1 m, m; it grows with the square.",
            callback=_detector("depth_noise"),
        ),
    ] = 0.005,
    grid: Annotated[
        Path | None,
        typer.Option("--grid", metavar="MAP.yaml", help="With --detections: walls that hide, recorded as well."),
    ] = None,
    poses: Annotated[bool, typer.Option(help="Follow the file's agent poses, where it has them.")] = True,
    robot: RobotOption = None,
    seed: Seed = 0,
) -> None:
    """Walk a robot through a graph and record what it sees, as updates that reveal the graph bit by bit.

    The true poses go to a topic of their own (/ground_truth), for evaluation only.
    """
    import numpy as np

    from semloc_core.graph import Reading, advice, listed, number_of
    from semloc_core.sources import (
        DetectorConfig,
        SimulationConfig,
        read_nav2,
        simulate_detections,
        simulate_traversal,
        write_detections,
        write_run,
    )

    file = read_graph(graph, Reading.of(labelspace, synonyms))
    numbers = Counter(thing.class_ for thing in file.graph.objects.values() if number_of(thing.class_) is not None)
    if numbers:
        note(f"{graph}: class numbers without names are recorded as such: {listed(numbers)}; {advice(numbers)}")
    shared: dict[str, object] = {"speed_mps": speed, "distance_m": distance, "range_m": range_m, "drift": drift}
    given = {"miss_rate": miss_rate, "false_rate": false_rate, "rate_hz": rate}
    shared |= {name: value for name, value in given.items() if value is not None}
    agents = file.agents_of(robot) if poses and (file.agents or robot) else None
    if agents and len(file.robots) > 1:
        names = ", ".join(file.robots)
        note(f"{graph}: poses of {len(file.robots)} robots, {names}: those of {agents[0].robot} are followed")
    if not agents and not distance:
        raise ConfigError(f"expected --distance more than 0 where no recorded poses are followed (got {distance:g})")
    way = f"along {len(agents)} recorded poses" if agents else f"along {distance:g} m of random goals"
    if detections:
        seen_by = {"cameras": cameras, "horizontal_fov_deg": fov}
        errors = {"confusion_rate": confusion_rate, "depth_noise": depth_noise}
        detector = DetectorConfig.of(**shared, frame_id=building_name(graph), **seen_by, **errors)
        walls = None if grid is None else read_nav2(grid)
        glances = simulate_detections(file.graph, detector, np.random.default_rng(seed), agents=agents, grid=walls)
        count = write_detections(output, glances, truth_frame=detector.frame_id, grid=walls)
        console.print(f"{output}: {count} frames of detections, {way}")
        return
    frame = "odom" if drift else building_name(graph)
    config = SimulationConfig.of(**shared, frame_id=frame, position_noise_m=position_noise, shared_frame=True)
    steps = simulate_traversal(file.graph, config, np.random.default_rng(seed), agents=agents)
    count = write_run(output, steps, truth_frame=building_name(graph))
    console.print(f"{output}: {count} updates, {way}")
