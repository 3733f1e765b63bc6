"""``semloc introspect``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from semloc_core.cli.shared.common import (
    Json,
    LabelspaceOption,
    MethodsOption,
    Seed,
    SynonymsOption,
    building_name,
    by_comma,
    console,
    progress,
    read_graph,
)
from semloc_core.cli.shared.foreign_classes import report_unknown_classes
from semloc_core.cli.shared.outputs import Writes, output_option
from semloc_core.errors import ConfigError
from semloc_core.files import PAGE, STUDY, write_whole

if TYPE_CHECKING:
    from semloc_core.introspection import Introspection
    from semloc_core.metrics import Row


def introspect(
    source: Annotated[
        Path,
        typer.Argument(metavar="GRAPH|MAP", help="A scene graph, to train on; or a map, whose own encoder is studied."),
    ],
    building: Annotated[
        str | None, typer.Option("--building", metavar="NAME", help="Of a MAP with several: the building to study.")
    ] = None,
    output: Annotated[Path | None, output_option("HTML", PAGE, "Write the study as one page.")] = None,
    keep_file: Annotated[
        Path | None,
        typer.Option(
            "--keep",
            metavar="FILE",
            parser=Writes(STUDY),
            help="Keep the page's content, for `semloc report` to use.",
        ),
    ] = None,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Trainings, with seeds from --seed on.")] = 3,
    methods: MethodsOption = None,
    places: Annotated[
        int | None, typer.Option("--places", min=1, help="Explain so many places, drawn at random; default: all.")
    ] = None,
    encoder: Annotated[
        str | None, typer.Option(help="paper (the default), or geodesic_attention; a MAP brings its own.")
    ] = None,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="Training steps; default as in training.")] = None,
    traversals: Annotated[
        bool,
        typer.Option("--traversals/--no-traversals", help="Test the third hypothesis: two more trainings a seed."),
    ] = True,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Explain every place, remove every class: which explainers can be trusted, and which classes matter.

    On a GRAPH it trains an encoder a seed; on a MAP it studies the map's own, on variants of the building by the seeds.
    """
    from semloc_core.explain import EXPLAINERS, check_methods
    from semloc_core.files import MAP, kind_of
    from semloc_core.graph import GraphArrays, Reading, count_unknown
    from semloc_core.introspection import MOVED_M, ranking_rows
    from semloc_core.introspection import introspect as study
    from semloc_core.map_database import load
    from semloc_core.metrics import document
    from semloc_core.training import train_config

    chosen = list(EXPLAINERS) if methods is None else by_comma(methods)
    check_methods(chosen)
    if kind_of(source) == MAP:
        if encoder is not None or steps is not None:
            raise ConfigError(
                "expected a GRAPH with --encoder or --steps (got a map, which brings its trained encoder)"
            )
        loaded = load(source)
        names = ", ".join(loaded.buildings)
        if building is None and len(loaded.buildings) != 1:
            raise ConfigError(f"expected --building, one of {names} (got none)")
        name = building or loaded.buildings[0]
        model, space, graph = loaded.model, loaded.model.labelspace, loaded.graph(name)
    else:
        if building is not None:
            raise ConfigError("expected a MAP with --building (got a graph)")
        reading = Reading.of(labelspace, synonyms)
        read = read_graph(source, reading)
        model, space, graph, name = None, reading.classes_of([read.labelspace]), read.graph, building_name(source)
        report_unknown_classes(count_unknown(graph, space), str(source))
    config = train_config(encoder or "paper", **({"steps": steps} if steps is not None else {}))
    arrays = GraphArrays.from_scene_graph(graph, space, name)
    with progress("introspecting") as bar:
        found = study(
            arrays,
            space,
            seeds=range(seed, seed + seeds),
            config=config,
            methods=chosen,
            n_places=places,
            moved_m=MOVED_M if traversals else None,
            model=model,
            progress=bar,
        )
    table = ranking_rows(found.runs, chosen)
    _print_study(found, table)
    if json_file is not None:
        write_whole(json_file, document("introspect", seed, [str(source)], [*table, *found.rows]))
    if output is not None or keep_file is not None:
        from semloc_core.report import introspection_page, keep

        page = introspection_page(found, arrays.name)
        if keep_file is not None:
            keep(page, keep_file)
        if output is not None:
            text = page.html()
            write_whole(output, text.encode())
            console.print(f"{output}: {len(text.encode()) / 1e3:.0f} kB")


def _print_study(found: Introspection, table: Sequence[Row]) -> None:
    """The study's tables and verdicts; ``table``: classes by falling importance."""
    from semloc_core.explain import BUDGET
    from semloc_core.introspection import check_lines, mean_rows, overall
    from semloc_core.metrics import cell, print_table

    console.print("which explainers passed the checks")
    for line in check_lines(found.checks):
        console.print(f"  {line}")
    console.print("classes by falling importance (Table IV)")
    for row in table:  # a line each, because class names are long
        ranked = [str(value) for name, value in row.items() if name not in ("method", "scope")]
        console.print(f"  {row['method']:22}{row['scope']:8}{' > '.join(ranked)}")
    at_budget = [row for row in found.table if row.get("budget") == BUDGET]
    print_table(at_budget, title=f"fidelity at a budget of {BUDGET:g}", console=console)
    print_table(found.controls, title="do explainers beat the controls? (characterisation score)", console=console)
    print_table(found.agreement, title="agreement of runs, of explainers, and with ablation", console=console)
    print_table(found.frequency, title="importance per object and class frequency (Spearman)", console=console)
    print_table(
        mean_rows(found.sanity), title="sanity: rank correlation with the model as it is, the zero baseline",
        console=console,
    )  # fmt: skip
    for number, said in overall(found.hypotheses).items():
        console.print(f"hypothesis {number}: {said}")
        for row in found.hypotheses:
            if row["decides"] and row["hypothesis"] == number:
                console.print(f"  {row['claim']}, by {row['method']}, for {row['scope']}:")
                console.print(f"    {cell(row, 'figure')}, {row['null']:g} if it were not so: {row['verdict']}")
