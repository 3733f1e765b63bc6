"""``semloc evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from semloc_core.cli.evaluate import detections as evaluate_detections
from semloc_core.cli.evaluate import merge as evaluate_merge
from semloc_core.cli.evaluate import shortlist
from semloc_core.cli.evaluate import town as evaluate_town
from semloc_core.cli.evaluate import trust as evaluate_trust
from semloc_core.cli.evaluate.options import Models, Root, Verified, Walks
from semloc_core.cli.shared.common import (
    Json,
    LabelspaceOption,
    Seed,
    SynonymsOption,
    by_comma,
    console,
    progress,
    read_graph,
    show,
    write_json,
)
from semloc_core.cli.shared.foreign_classes import report_unknown_classes
from semloc_core.cli.shared.outputs import App
from semloc_core.cli.shared.screen import print_pivot

app = App(no_args_is_help=True, help="Measure: the paper's protocol, and whole buildings.")
app.command("merge")(evaluate_merge.merge)
app.command("trust")(evaluate_trust.trust)
app.command("detections")(evaluate_detections.detections)
app.command("shortlist")(shortlist.shortlist)
app.command("town")(evaluate_town.town)


@app.command("office")
def office(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="The building.")],
    ablation: Annotated[bool, typer.Option("--ablation", help="The paper's Table III instead of Table II.")] = False,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds, from --seed on.")] = 3,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """The paper's protocol on one graph: two perturbed variants, 70/20/10 by place, 4 m (Tables II and III).

    recall@N is positives found in the top N over all positives, as the paper's figures are; recall_ceiling@N is the
    best it can be. success@N is what users mean: any of the top N within 4 m.
    """
    from semloc_core.evaluate import evaluate_ablation, evaluate_office
    from semloc_core.graph import GraphArrays, Reading, count_unknown

    reading = Reading.of(labelspace, synonyms)
    file = read_graph(graph, reading)
    space = reading.classes_of([file.labelspace])
    report_unknown_classes(count_unknown(file.graph, space), str(graph))
    arrays = GraphArrays.from_scene_graph(file.graph, space, graph.stem)
    with progress("evaluating") as bar:
        run = evaluate_ablation if ablation else evaluate_office
        rows = run(arrays, space, seeds=tuple(range(seed, seed + seeds)), progress=bar)
    command = "evaluate office --ablation" if ablation else "evaluate office"
    show(command, seed, [graph], rows, json_file, title="Table III" if ablation else "Table II")


@app.command("relocalise")
def relocalise(
    root: Root,
    model: Models = None,
    train: Annotated[bool, typer.Option(help="Train the paper's encoder on the maps and evaluate it too.")] = True,
    verified: Verified = True,
    per_building: Annotated[bool, typer.Option(help="A row for each building.")] = True,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Every building's query graph against all buildings' maps in one database; within 4 m, in the right building."""
    from semloc_core.encoding import Model
    from semloc_core.evaluate import evaluate_relocalise

    with progress("evaluating") as bar:
        rows = evaluate_relocalise(
            root,
            models=[Model.load(m) for m in model or []],
            train_paper=train,
            verified=verified,
            seed=seed,
            progress=bar,
        )
    shown = rows if per_building else [row for row in rows if row["scope"] == "all"]
    show("evaluate relocalise", seed, [root], shown, json_file, title=str(root))


@app.command("online")
def online(
    root: Root,
    model: Models = None,
    walks: Walks = 10,
    range_m: Annotated[float, typer.Option(min=0.0, help="Sensing range along the graph, m.")] = 4.0,
    flicker_rate: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Chance, a step, that an object in range is lost until seen again.")
    ] = 0.0,
    object_noise_m: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation of an object's position, m per axis.")
    ] = 0.0,
    place_noise_m: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation of a place's position, m per axis.")
    ] = 0.0,
    drift: Annotated[
        float, typer.Option(min=0.0, help="Drift of the robot's frame; 1: 0.5° and 0.03 m per axis, a root metre.")
    ] = 0.0,
    filtered: Annotated[
        bool, typer.Option("--filter/--no-filter", help="With the filter too (verified answers).")
    ] = True,
    verified: Verified = True,
    kidnapped: Annotated[
        bool, typer.Option("--kidnapped", help="Metres until right again, after being carried away.")
    ] = False,
    foreign: Annotated[
        bool, typer.Option("--foreign", help="Answers accepted in a building that is left out of the database.")
    ] = False,
    bound: Annotated[bool, typer.Option(help="Count the places that agree with all that was seen.")] = True,
    peer: Annotated[
        bool, typer.Option("--peer", help="CLIPPER too, registered against every building: a minute a hundred answers.")
    ] = False,
    distractors: Annotated[
        list[Path] | None,
        typer.Option(
            "--distractors",
            metavar="DIR",
            help="Asked again with these buildings in the map too: DIR/*.json and */map.json; several times.",
        ),
    ] = None,
    changed: Annotated[
        bool, typer.Option("--changed", help="Asked again on another day, when some of the objects have changed:")
    ] = False,
    mislabelled: Annotated[float, typer.Option(min=0.0, max=1.0, help="· the share that has another name,")] = 0.2,
    gone: Annotated[float, typer.Option(min=0.0, max=1.0, help="· the share that is gone,")] = 0.3,
    moved: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="· the share that was moved, by about 3 m an axis.")
    ] = 0.2,
    query_labels: Annotated[
        list[Path] | None,
        typer.Option(
            "--query-labels",
            metavar="FILE",
            help="Asked again by a detector of other names, led back by the cross-walk: {synonyms: {couch: sofa, cup: "
            "unknown}}, the map's name first; several times.",
        ),
    ] = None,
    long: Annotated[
        bool, typer.Option("--long", help="Print every row, with intervals, success@5 and @10, as the JSON has them.")
    ] = False,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Every building's query graph revealed along walks, asked against all buildings' maps, by metres walked.

    Prints success@1 a line a method and a column for the metres walked, then calibration error, and what else was
    asked for, in small tables of their own.
    """
    from semloc_core.config import checked
    from semloc_core.encoding import Model
    from semloc_core.evaluate import AnotherDay, evaluate_online
    from semloc_core.graph import load_synonyms
    from semloc_core.metrics import Row, online_pivots
    from semloc_core.sources import WalkConfig

    config = checked(
        WalkConfig,
        range_m=range_m,
        flicker_rate=flicker_rate,
        object_noise_m=object_noise_m,
        place_noise_m=place_noise_m,
        drift=drift,
    )
    day = AnotherDay(mislabelled=mislabelled, gone=gone, moved=moved)
    cases: list[tuple[str, list[Path], AnotherDay | None, dict[str, str] | None]] = [("as mapped", [], None, None)]
    cases += [("with distractors", distractors, None, None)] if distractors else []
    cases += [("changed", [], day, None)] if changed else []
    cases += [(f"asked by {table.name}", [], None, load_synonyms(table)) for table in query_labels or []]
    every: list[Row] = []
    models = [Model.load(m) for m in model or []]
    for case, others, another_day, renamed in cases:
        with progress("evaluating") as bar:
            rows = evaluate_online(
                root,
                models=models,
                config=config,
                walks=walks,
                filtered=filtered,
                verified=verified,
                kidnapped=kidnapped,
                foreign=foreign,
                bound=bound,
                peer=peer,
                distractors=others,
                another_day=another_day,
                query_labels=renamed,
                seed=seed,
                progress=bar,
            )
        every += rows if len(cases) == 1 else [{"case": case, **row} for row in rows]
        if not long:
            of = f"{root}, {case}" if len(cases) > 1 else str(root)
            console.print(
                f"{of}: {rows[0]['queries']} walks; columns are metres walked; intervals: --long", markup=False
            )
            for pivot in online_pivots(rows):
                print_pivot(pivot, console)
    inputs = [root, *(distractors or []), *(query_labels or [])]
    if long:
        show("evaluate online", seed, inputs, every, json_file, title=str(root))
    elif json_file is not None:
        write_json(json_file, "evaluate online", seed, inputs, every)


@app.command("candidates")
def candidates(
    root: Root,
    model: Annotated[
        list[Path] | None,
        typer.Option("--model", metavar="MODEL", help="Evaluate this trained model too."),
    ] = None,
    baselines: Annotated[
        str, typer.Option("--baselines", metavar="NAME,…", help="Encoders with nothing to train, by comma.")
    ] = "bag_of_words,rings,general",
    walks: Annotated[int, typer.Option(min=1, help="Walks in each building for each length.")] = 10,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """How often the right place is among the first 1, 10, 100, 300: whole query graphs, and 0, 5, 10 m walked."""
    from semloc_core.encoding import load_model
    from semloc_core.evaluate import evaluate_candidates

    chosen = [name for name in by_comma(baselines) if name]
    models = [(path.stem, load_model(path)) for path in model or []]
    with progress("evaluating") as bar:
        rows = evaluate_candidates(root, models=models, baselines=chosen, walks=walks, seed=seed, progress=bar)
    show("evaluate candidates", seed, [root], rows, json_file, title=str(root))


@app.command("layout")
def layout(
    root: Root,
    walks: Walks = 5,
    distractors: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DIR", help="These buildings are in the map too: DIR/*.json and */map.json; several times."
        ),
    ] = None,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """What each part of verification by layout is worth: success along walks with a part left out."""
    from semloc_core.evaluate import evaluate_layout

    with progress("evaluating") as bar:
        rows = evaluate_layout(root, walks=walks, distractors=distractors or [], seed=seed, progress=bar)
    show("evaluate layout", seed, [root, *(distractors or [])], rows, json_file, title=str(root))
