"""``semloc bag``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.shared.common import LabelspaceOption, Seed, building_name, console, pick_labelspace, read_graph

app = typer.Typer(no_args_is_help=True, help="Make bags.")


@app.command("simulate")
def simulate(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="The building to walk through.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="RUN", help="The bag: a .mcap or a folder.")],
    labelspace: LabelspaceOption = None,
    speed: Annotated[float, typer.Option(help="Walking speed, m/s.")] = 0.5,
    distance: Annotated[float, typer.Option(help="How far to walk, m; agent poses are followed to their end.")] = 60.0,
    range_m: Annotated[float, typer.Option("--range", help="Sensing range along walkable ways, m.")] = 5.0,
    miss_rate: Annotated[float, typer.Option(help="Share of the objects that are never detected.")] = 0.1,
    false_rate: Annotated[float, typer.Option(help="Invented objects for each true one.")] = 0.05,
    position_noise: Annotated[float, typer.Option(help="Standard deviation of object positions, m.")] = 0.1,
    rate: Annotated[float, typer.Option(help="Updates per second.")] = 2.0,
    poses: Annotated[bool, typer.Option(help="Follow the file's agent poses, where it has them.")] = True,
    seed: Seed = 0,
) -> None:
    """Walk a robot through a graph and record what it sees, as updates that reveal the graph bit by bit.

    The true positions go to a topic of their own (/ground_truth), for evaluation only.
    """
    import numpy as np

    from semloc_core.sources import SimulationConfig, simulate_traversal, write_run

    file = read_graph(graph, pick_labelspace(labelspace))
    config = SimulationConfig.of(
        speed_mps=speed,
        distance_m=distance,
        range_m=range_m,
        miss_rate=miss_rate,
        false_rate=false_rate,
        position_noise_m=position_noise,
        rate_hz=rate,
        frame_id=building_name(graph),
    )
    agents = file.agents if poses and file.agents else None
    steps = simulate_traversal(file.graph, config, np.random.default_rng(seed), agents=agents)
    count = write_run(output, steps)
    way = f"along {len(agents)} recorded poses" if agents else f"along {distance:g} m of random goals"
    console.print(f"{output}: {count} updates, {way}")
