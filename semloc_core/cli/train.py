"""``semloc train``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from semloc_core.cli.common import (
    LabelspaceOption,
    Seed,
    building_name,
    console,
    note,
    pick_labelspace,
    progress,
    read_graph,
    report_unknown_classes,
)


def train(
    graphs: Annotated[list[Path], typer.Argument(metavar="GRAPH...", help="Graphs of the buildings to train on.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MODEL", help="Where to write the model.")],
    loss: Annotated[
        Literal["infonce", "triplet", "contrastive", "mil_nce"] | None,
        typer.Option(help="Training loss; none given: the encoder's own (infonce; geodesic_attention: mil_nce)."),
    ] = None,
    encoder: Annotated[
        str,
        typer.Option(
            help="paper or geodesic_attention; rings, bag_of_words, tfidf and histogram have no weights to train."
        ),
    ] = "paper",
    views: Annotated[
        Literal["paper", "detector"] | None,
        typer.Option(
            help="What training pairs differ in: objects displaced (paper), or also places sampled anew, objects "
            "missed, invented and mislabelled, as on a robot's new run (detector). None given: the encoder's own."
        ),
    ] = None,
    labelspace: LabelspaceOption = None,
    layers: Annotated[int, typer.Option(min=1, max=8, help="Message-passing layers (paper).")] = 2,
    hidden: Annotated[int, typer.Option(min=1, max=1024, help="Hidden dimension (paper).")] = 64,
    heads: Annotated[int, typer.Option(min=0, max=16, help="Attention heads (paper); 0: no attention.")] = 3,
    self_loops: Annotated[bool, typer.Option(help="A place attends to itself too (paper).")] = True,
    steps: Annotated[int | None, typer.Option(min=1, help="Training steps at most.")] = None,
    max_seconds: Annotated[float | None, typer.Option(min=1.0, help="Stop training after this many seconds.")] = None,
    curve: Annotated[Path | None, typer.Option(metavar="PNG", help="Draw the loss curve.")] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="STATE", help="Keep the training state here, and go on from it if it exists.")
    ] = None,
    seed: Seed = 0,
) -> None:
    """Train an encoder on one or several buildings' graphs.

    Self-supervised: perturbed variants of a graph give pairs of the same place (paper, section IV). Nothing but the
    graphs is needed; the labelspace is taken from the files unless --labelspace names another.
    """
    from semloc_core.graph_arrays import GraphArrays
    from semloc_core.labelspace import count_unknown, union
    from semloc_core.training.config import PERTURBATIONS, train_config
    from semloc_core.training.curve import plot_curve
    from semloc_core.training.loop import Report
    from semloc_core.training.loop import train as run_training

    chosen = pick_labelspace(labelspace)
    files = [read_graph(path, chosen) for path in graphs]
    space = chosen or union([f.labelspace for f in files if f.labelspace is not None])
    for path, file in zip(graphs, files, strict=True):
        report_unknown_classes(count_unknown(file.graph, space), str(path))
    if chosen is None and space.classes and all(name.startswith("class_") for name in space.classes):
        note("the graphs have numbers in place of class names; if you know which classes they are, use --labelspace")
    arrays = [
        GraphArrays.from_scene_graph(f.graph, space, building_name(p)) for p, f in zip(graphs, files, strict=True)
    ]
    config = train_config(
        encoder,
        encoder_options=(
            {"layers": layers, "hidden": hidden, "heads": max(heads, 1), "gat": heads > 0, "self_loops": self_loops}
            if encoder == "paper"
            else {}
        ),
        seed=seed,
        **({"loss": loss} if loss is not None else {}),
        **({"perturb": PERTURBATIONS[views], "validate": PERTURBATIONS[views]} if views is not None else {}),
        **({"steps": steps} if steps is not None else {}),
        **({"max_seconds": max_seconds} if max_seconds is not None else {}),
    )
    with progress(f"training {encoder}") as bar:

        def on_step(report: Report) -> None:
            bar(report.step, report.steps, f"loss {report.train_loss:.3f}, validation PR-AUC {report.val_pr_auc:.3f}")

        resumed = resume if resume is not None and resume.exists() else None
        result = run_training(arrays, space, config, progress=on_step, resume=resumed, checkpoint=resume)
    result.model.save(output)
    if curve is not None:
        if result.history:
            plot_curve(result.history, curve)
        else:
            note(f"{encoder} has nothing to train, so there is no curve")
    console.print(f"{output}: {encoder}, {len(space)} classes, hash {result.model.hash[:12]}")
    if result.history:
        best = max(row["val_pr_auc"] for row in result.history)
        console.print(f"validation PR-AUC {best:.3f} at step {result.best_step} (stopped: {result.stopped})")
