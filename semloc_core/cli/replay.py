"""``semloc replay``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from semloc_core.cli.shared.common import Json, SynonymsOption, console, join_synonyms, note, write_json
from semloc_core.cli.shared.foreign_classes import report_unknown_classes
from semloc_core.config import LocaliserConfig, checked, options

if TYPE_CHECKING:
    from semloc_core.localiser import Localiser
    from semloc_core.replay import ReplaySummary

_HELP = {option.name: option.description for option in options(LocaliserConfig)}
_DEFAULT = LocaliserConfig()
OUTAGE_S = 60.0
"""So long a map's server may be silent before a replay ends: its answers must not hang on when it was."""


def replay(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The recorded run.")],
    map_: Annotated[
        str, typer.Option("--map", metavar="MAP|URL", help="The map file, or milvus+http://host:port/name.")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="RESULTS", help="Write matches and attributions to a bag.")
    ] = None,
    topic: Annotated[str, typer.Option(help="Topic of the scene-graph updates.")] = "/scene_graph",
    top_n: Annotated[int, typer.Option(help=_HELP["top_n"])] = _DEFAULT.top_n,
    explainer: Annotated[str, typer.Option(metavar="NAME", help=_HELP["explainer"])] = _DEFAULT.explainer,
    explain_rate_hz: Annotated[float, typer.Option(help=_HELP["explain_rate_hz"])] = _DEFAULT.explain_rate_hz,
    accept_probability: Annotated[float, typer.Option(help=_HELP["accept_probability"])] = _DEFAULT.accept_probability,
    rerank: Annotated[str, typer.Option("--rerank", metavar="none|layout", help=_HELP["rerank"])] = _DEFAULT.rerank,
    filter_: Annotated[str, typer.Option("--filter", metavar="none|bayes", help=_HELP["filter"])] = _DEFAULT.filter,
    buildings: Annotated[
        list[str] | None, typer.Option("--buildings", metavar="PATTERN", help=_HELP["buildings"])
    ] = None,
    synonyms: SynonymsOption = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only the closing table.")] = False,
    json_file: Json = None,
) -> None:
    """Localise along a recorded run: the node's work without ROS, the same bytes from run to run.

    Prints an answer a second of the run, then a table: success within 4 m by distance travelled, where the run brings
    its ground truth, and latency. A map's server that stops answering is waited for, a minute at most.
    """
    import torch

    from semloc_core.cli.replay_table import print_summary
    from semloc_core.fleet import open_localiser
    from semloc_core.replay import Answer
    from semloc_core.replay import replay as run_replay

    torch.set_num_threads(1)
    config = checked(
        LocaliserConfig,
        top_n=top_n,
        explainer=explainer,
        explain_rate_hz=explain_rate_hz,
        accept_probability=accept_probability,
        rerank=rerank,
        filter=filter_,
        buildings=tuple(buildings or ()),
    )
    shown_ns: list[int] = []

    def on_answer(answer: Answer) -> None:
        stamp = answer.matches.stamp_ns
        if quiet or (shown_ns and 0 <= stamp - shown_ns[-1] < 1_000_000_000):
            return
        shown_ns[:] = [shown_ns[0] if shown_ns else stamp, stamp]
        console.print(_line(answer, (stamp - shown_ns[0]) / 1e9))

    localiser = open_localiser(map_, config, outage_s=OUTAGE_S)
    join_synonyms(localiser.map.model, synonyms)
    try:
        summary = run_replay(run, localiser, config, topic=topic, results=output, on_answer=on_answer)
    finally:
        localiser.close()
    report_unknown_classes(dict(summary.unknown_classes), str(run), labelspace=False)
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
        note("no ground truth in the run: nothing to score")


def _line(answer: object, seconds: float) -> str:
    from semloc_core.replay import Answer

    assert isinstance(answer, Answer)
    matches, why = answer.matches, ""
    if answer.attributions is not None and matches.status != "unknown":
        named = [c for c in answer.attributions.classes[:4] if c.share >= 0.005]
        why = "  because " + ", ".join(f"{c.class_} {c.share:.0%}" for c in named)
    if not matches.matches:
        return f"{seconds:7.1f} s  {matches.status}"
    best = matches.matches[0]
    x, y, z = best.position
    return (
        f"{seconds:7.1f} s  {matches.status:9s}  {best.map} ({x:.1f}, {y:.1f}, {z:.1f}) "
        f"p={best.probability:.2f} s={best.similarity:.3f}{why}"
    )
