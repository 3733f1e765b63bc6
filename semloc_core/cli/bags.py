"""``semloc bag``."""

from __future__ import annotations

from collections import Counter
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
from semloc_core.cli.shared.outputs import App, Writes
from semloc_core.files import BAG

app = App(no_args_is_help=True, help="Make bags.")


@app.command("simulate")
def simulate(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="The building to walk through.")],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="RUN",
            parser=Writes(BAG),
            help="The bag: a .mcap or a folder.",
        ),
    ],
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    speed: Annotated[float, typer.Option(help="Walking speed, m/s.")] = 0.5,
    distance: Annotated[float, typer.Option(help="How far to walk, m; agent poses are followed to their end.")] = 60.0,
    range_m: Annotated[float, typer.Option("--range", help="Sensing range along walkable ways, m.")] = 5.0,
    miss_rate: Annotated[float, typer.Option(help="Share of the objects that are never detected.")] = 0.1,
    false_rate: Annotated[float, typer.Option(help="Invented objects for each true one.")] = 0.05,
    position_noise: Annotated[float, typer.Option(help="Standard deviation of object positions, m.")] = 0.1,
    rate: Annotated[float, typer.Option(help="Updates per second.")] = 2.0,
    drift: Annotated[
        float, typer.Option(min=0.0, help="Drift of the run's frame; 1: 0.5° and 0.03 m per axis, a root metre.")
    ] = 0.0,
    poses: Annotated[bool, typer.Option(help="Follow the file's agent poses, where it has them.")] = True,
    robot: RobotOption = None,
    seed: Seed = 0,
) -> None:
    """Walk a robot through a graph and record what it sees, as updates that reveal the graph bit by bit.

    The true poses go to a topic of their own (/ground_truth), for evaluation only.
    """
    import numpy as np

    from semloc_core.graph import Reading, advice, listed, number_of
    from semloc_core.sources import SimulationConfig, simulate_traversal, write_run

    file = read_graph(graph, Reading.of(labelspace, synonyms))
    numbers = Counter(thing.class_ for thing in file.graph.objects.values() if number_of(thing.class_) is not None)
    if numbers:
        note(f"{graph}: class numbers without names are recorded as such: {listed(numbers)}; {advice(numbers)}")
    config = SimulationConfig.of(
        speed_mps=speed,
        distance_m=distance,
        range_m=range_m,
        miss_rate=miss_rate,
        false_rate=false_rate,
        position_noise_m=position_noise,
        rate_hz=rate,
        shared_frame=True,
        drift=drift,
        frame_id="odom" if drift else building_name(graph),
    )
    agents = file.agents_of(robot) if poses and (file.agents or robot) else None
    if agents and len(file.robots) > 1:
        names = ", ".join(file.robots)
        note(f"{graph}: poses of {len(file.robots)} robots, {names}: those of {agents[0].robot} are followed")
    steps = simulate_traversal(file.graph, config, np.random.default_rng(seed), agents=agents)
    count = write_run(output, steps, truth_frame=building_name(graph))
    way = f"along {len(agents)} recorded poses" if agents else f"along {distance:g} m of random goals"
    console.print(f"{output}: {count} updates, {way}")
