"""``semloc replay``."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from semloc_core.cli.shared.common import (
    Json,
    LabelspaceOption,
    RobotOption,
    SynonymsOption,
    ToleranceOption,
    TopicOption,
    console,
    note,
    tell,
    write_json,
)
from semloc_core.cli.shared.foreign_classes import report_unknown_classes
from semloc_core.cli.shared.outputs import Writes, output_option
from semloc_core.cli.shared.words import within
from semloc_core.config import LocaliserConfig, checked, options
from semloc_core.files import BAG, TRAJECTORY

if TYPE_CHECKING:
    from semloc_core.localiser import Localiser
    from semloc_core.replay import ReplaySummary

_HELP = {option.name: option.description for option in options(LocaliserConfig)}
_DEFAULT = LocaliserConfig()
_own = partial(within, lambda: LocaliserConfig)
OUTAGE_S = 60.0
"""So long a map's server may be silent before a replay ends: its answers must not hang on when it was."""


def replay(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run: a bag, recorded or simulated.")],
    map_: Annotated[
        str, typer.Option("--map", metavar="MAP|URL", help="The map file, or milvus+http://host:port/name.")
    ],
    output: Annotated[
        Path | None, output_option("RESULTS", BAG, "Write matches, evidence and attributions to a bag.")
    ] = None,
    tum: Annotated[
        Path | None,
        typer.Option(
            "--tum",
            metavar="FILE",
            parser=Writes(TRAJECTORY),
            help="Write the poses of matches as TUM files, one a building.",
        ),
    ] = None,
    topic: TopicOption = None,
    robot: RobotOption = None,
    truth_topic: Annotated[
        str | None,
        typer.Option("--truth-topic", metavar="TOPIC", help="Ground truth; default: ground_truth beside the updates."),
    ] = None,
    truth_tolerance: ToleranceOption = 0.05,
    top_n: Annotated[int, typer.Option(help=_HELP["top_n"], callback=_own("top_n"))] = _DEFAULT.top_n,
    explainer: Annotated[
        str, typer.Option(metavar="NAME", help=_HELP["explainer"], callback=_own("explainer"))
    ] = _DEFAULT.explainer,
    explain_rate_hz: Annotated[
        float, typer.Option(help=_HELP["explain_rate_hz"], callback=_own("explain_rate_hz"))
    ] = _DEFAULT.explain_rate_hz,
    accept_probability: Annotated[
        float, typer.Option(help=_HELP["accept_probability"], callback=_own("accept_probability"))
    ] = _DEFAULT.accept_probability,
    rerank: Annotated[
        str, typer.Option("--rerank", metavar="none|layout", help=_HELP["rerank"], callback=_own("rerank"))
    ] = _DEFAULT.rerank,
    filter_: Annotated[
        str, typer.Option("--filter", metavar="none|bayes", help=_HELP["filter"], callback=_own("filter"))
    ] = _DEFAULT.filter,
    buildings: Annotated[
        list[str] | None, typer.Option("--buildings", metavar="PATTERN", help=_HELP["buildings"])
    ] = None,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the closing table.")] = False,
    json_file: Json = None,
) -> None:
    """Localise along a recorded run: the node's work without ROS, the same bytes from run to run.

    Prints an answer a second of the run, those that are wrong marked, then a table: success within 4 m by distance
    travelled, where the run brings its ground truth, and latency. A map's server that stops answering is waited for, a
    minute at most.
    """
    config = checked(
        LocaliserConfig,
        top_n=top_n,
        explainer=explainer,
        explain_rate_hz=explain_rate_hz,
        accept_probability=accept_probability,
        rerank=rerank,
        filter=filter_,
        buildings=tuple(buildings or ()),
        labelspace=labelspace or "",
        synonyms=str(synonyms or ""),
    )
    import torch

    from semloc_core.cli.replay_lines import Lines
    from semloc_core.cli.replay_table import print_summary
    from semloc_core.fleet import open_localiser
    from semloc_core.graph import advice
    from semloc_core.replay import replay as run_replay
    from semloc_core.wire import TumWriter

    torch.set_num_threads(1)
    lines = Lines(console.print)
    localiser = open_localiser(map_, config, outage_s=OUTAGE_S)
    writer = TumWriter(tum, localiser.buildings) if tum is not None else None
    try:
        with writer or nullcontext():
            summary = run_replay(
                run,
                localiser,
                config,
                topic=topic,
                robot=robot,
                truth_topic=truth_topic,
                truth_tolerance_s=truth_tolerance,
                results=output,
                tum=writer,
                on_answer=None if quiet else lines.answer,
                on_scored=None if quiet else lines.scored,
            )
    finally:
        lines.finish()
        localiser.close()
    labels = localiser.live.labels
    tell(run, labels.told() if labels is not None else [])
    report_unknown_classes(summary.unknown_classes, str(run), advise=not summary.all_unknown)
    if summary.all_unknown:
        note(f"{run}: {summary.all_unknown}; {advice(summary.unknown_classes)}")
    for line in summary.said:
        note(f"{run}: {line}")
    if summary.truths and (summary.truth_apart_ns or not summary.matched):
        note(
            f"ground truth: {summary.matched} answers have one within {truth_tolerance * 1e3:g} ms of their stamp, "
            f"{summary.truth_apart_ns / 1e6:g} ms off at most"
        )
    dropped = {k: v for k, v in sorted(summary.counts.items()) if k != "applied" and v}
    if dropped:
        note("updates not applied: " + ", ".join(f"{count} {name}" for name, count in dropped.items()))
    _tell_scoring(summary, localiser)
    print_summary(f"{run} against {map_}", summary, console)
    if json_file is not None:
        rows: list[dict[str, Any]] = [{**row, "p50_ms": None, "p99_ms": None} for row in summary.rows]
        rows = rows or [{"method": "latency", "scope": "all", "queries": sum(summary.statuses.values())}]
        rows[-1] |= {"p50_ms": summary.p50_ms, "p99_ms": summary.p99_ms}
        write_json(json_file, "replay", 0, [run, map_], rows)
    if output is not None:
        console.print(f"results: {output}")
    if writer is not None:
        console.print("trajectories: " + (", ".join(map(str, writer.files)) or "none, no answer was a match"))


def _tell_scoring(summary: ReplaySummary, localiser: Localiser) -> None:
    """Say where figures are not simply of the building that the ground truth names."""
    buildings = localiser.buildings
    left_out = summary.truth_frames & (set(localiser.map.all_buildings) - set(buildings))
    if left_out:
        names = ", ".join(sorted(left_out))
        note(f"the ground truth is in {names}, which --buildings leaves out: every answer there is wrong")
    unnamed = summary.truth_frames - set(localiser.map.all_buildings)
    if unnamed and len(buildings) == 1:
        frames = ", ".join(sorted(unnamed))
        note(f"the ground truth is in frame {frames}; scored as if that were building {buildings[0]}")
    if summary.unscored:
        why = "the ground truth names no building of this map" if buildings else "the map has no buildings"
        note(f"{summary.unscored} answers not scored: {why}")
    elif not summary.rows:
        why = f"{summary.truths} poses, none near an answer" if summary.truths else "none in the run"
        note(f"no ground truth to score with ({why})")
