"""``semloc train``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from semloc_core.cli.shared.common import (
    Json,
    LabelspaceOption,
    Seed,
    SynonymsOption,
    building_name,
    console,
    note,
    progress,
    read_graph,
    show,
)
from semloc_core.cli.shared.foreign_classes import AllowUnknown, check_classes, tell_numbers
from semloc_core.cli.shared.outputs import Writes, output_option
from semloc_core.errors import ConfigError
from semloc_core.files import MODEL, PICTURE, STATE

if TYPE_CHECKING:
    from semloc_core.metrics import Row
    from semloc_core.training import TrainResult

WHY_ENDED = {
    "steps": "it trained to its last step",
    "patience": "it stopped early, having got no better for long",
    "time": "it stopped when its time was up",
}
"""`TrainResult.stopped` in words."""


def train(
    graphs: Annotated[list[Path], typer.Argument(metavar="GRAPH...", help="Graphs of the buildings to train on.")],
    output: Annotated[Path, output_option("MODEL", MODEL, "Where to write the model.")],
    loss: Annotated[
        Literal["infonce", "triplet", "contrastive", "mil_nce"] | None,
        typer.Option(help="Training loss; none given: the encoder's own (mil_nce; paper: infonce)."),
    ] = None,
    encoder: Annotated[
        str | None,
        typer.Option(
            help="geodesic_attention (default), or paper; rings, bag_of_words, tfidf and histogram have no weights to "
            "train."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL|general",
            help="Go on from this model, with its classes; 'general': from the general encoder, fitted to the graphs.",
        ),
    ] = None,
    views: Annotated[
        Literal["paper", "detector"] | None,
        typer.Option(
            help="What training pairs differ in: objects displaced (paper), or also places sampled anew, objects "
            "missed, invented and mislabelled, as on a robot's new run (detector). None given: the encoder's own."
        ),
    ] = None,
    labelspace: LabelspaceOption = None,
    synonyms: SynonymsOption = None,
    allow_unknown: AllowUnknown = False,
    layers: Annotated[int, typer.Option(min=1, max=8, help="Message-passing layers (paper).")] = 2,
    hidden: Annotated[int, typer.Option(min=1, max=1024, help="Hidden dimension (paper).")] = 64,
    heads: Annotated[int, typer.Option(min=0, max=16, help="Attention heads (paper); 0: no attention.")] = 3,
    self_loops: Annotated[bool, typer.Option(help="A place attends to itself too (paper).")] = True,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Any other training option, or encoder.NAME=VALUE for one of the encoder; VALUE as in JSON.",
        ),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Training steps at most.")] = None,
    max_seconds: Annotated[float | None, typer.Option(min=1.0, help="Stop training after this many seconds.")] = None,
    curve: Annotated[
        Path | None, typer.Option(metavar="PNG", parser=Writes(PICTURE), help="Draw the loss curve.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="STATE",
            parser=Writes(STATE, in_place=True),
            help="Keep the training state here, and go on from it if it exists.",
        ),
    ] = None,
    seed: Seed = 0,
    json_file: Json = None,
) -> None:
    """Train an encoder on one or several buildings' graphs.

    Self-supervised: perturbed variants of a graph give pairs of the same place (paper, section IV). Nothing but the
    graphs is needed; the labelspace is taken from the files unless --labelspace names another, or --start has one.
    At the end it says how good the model is, and was at the start, on held-out places of these buildings as a
    detector would see them on another run: with the whole graph, and after a few metres' walk.
    """
    import msgspec

    from semloc_core.encoding import GENERAL, Model, general_model
    from semloc_core.graph import GraphArrays, Reading
    from semloc_core.training import DEFAULT_ENCODER, PERTURBATIONS, Report, own_validation, plot_curve, train_config
    from semloc_core.training import train as run_training

    begun = Model.load(start) if start not in (None, GENERAL) else None
    reading = Reading.of(labelspace, synonyms, begun.labelspace if begun is not None else None)
    if begun is not None:
        begun.labelspace = reading.space or begun.labelspace
    files = [read_graph(path, reading) for path in graphs]
    space = reading.classes_of([file.labelspace for file in files])
    for path, file in zip(graphs, files, strict=True):
        check_classes(file.graph, space, str(path), allow_unknown=allow_unknown)
    tell_numbers(space, reading)
    arrays = [
        GraphArrays.from_scene_graph(f.graph, space, building_name(p)) for p, f in zip(graphs, files, strict=True)
    ]
    if start == GENERAL:
        begun = general_model(arrays, space)
    name = encoder or (begun.encoder.name if begun is not None else DEFAULT_ENCODER)
    own = msgspec.to_builtins(begun.encoder.config) if begun is not None else {}
    if name == "paper" and begun is None:
        own = {"layers": layers, "hidden": hidden, "heads": max(heads, 1), "gat": heads > 0, "self_loops": self_loops}
    given, view = _given(options or []), PERTURBATIONS[views] if views is not None else None
    asked = {"loss": loss, "perturb": view, "validate": view, "steps": steps, "max_seconds": max_seconds}
    asked = {option: value for option, value in asked.items() if value is not None}
    encoder_options = own | given.pop("encoder_options")
    config = train_config(name, **{"encoder_options": encoder_options, "seed": seed, **asked, **given})
    with progress(f"training {name}") as bar:

        def on_step(report: Report) -> None:
            judged = "" if math.isnan(report.val_pr_auc) else f", PR-AUC {report.val_pr_auc:.3f} on held-out places"
            bar(report.step, report.steps, f"loss {report.train_loss:.3f}{judged}")

        def on_view(made: int, views: int) -> None:
            bar(made, views, "views of the buildings made" if made < views else "starting")

        resumed = resume if resume is not None and resume.exists() else None
        result = run_training(
            arrays, space, config, progress=on_step, resume=resumed, checkpoint=resume, start=begun, preparing=on_view
        )
    result.model.save(output)
    if curve is not None:
        if result.history:
            plot_curve(result.history, curve)
        else:
            note(f"{name} has nothing to train, so there is no curve")
    console.print(f"{output}: {name}, {len(space)} classes, hash {result.model.hash[:12]}")
    console.print(_kept(result) if result.stopped != "nothing to train" else f"{name} has nothing to train")
    trained = result.stopped != "nothing to train"
    before = {"start": begun} if begun is not None else {"general": general_model(arrays, space)} if trained else {}
    with progress("validating on held-out places") as bar:
        rows = own_validation({"trained": result.model, **before}, arrays, result.splits, seed, bar)
    show("train", seed, graphs, rows, json_file, title="own validation: held-out places, as a detector sees them")
    if not rows:
        console.print("no place was held out of training, so what it brought is not known")
    for name in before:
        for line in gains(rows, name, general=begun is None or start == GENERAL):
            console.print(line)


def _kept(result: TrainResult) -> str:
    """Which weights the model has, how good they are, and why there are no later ones."""
    last, best = result.history[-1], max(row["val_pr_auc"] for row in result.history)
    judged = f"the best on places held out for validation: PR-AUC {best:.3f}"
    if math.isnan(best):
        judged = "the last, since the places held out for validation tell nothing apart"
    return f"kept the weights of step {result.best_step} of {last['step']:.0f}, {judged}; {WHY_ENDED[result.stopped]}"


def _given(options: list[str]) -> dict[str, Any]:
    """Options by name, those of the encoder under ``encoder_options``."""
    given: dict[str, Any] = {"encoder_options": {}}
    for option in options:
        name, equals, text = option.partition("=")
        if not equals or name == "encoder_options":
            raise ConfigError(f"expected --set NAME=VALUE (got {option})")
        try:
            value = json.loads(text)
        except json.JSONDecodeError:
            value = text
        target = given["encoder_options"] if name.startswith("encoder.") else given
        target[name.removeprefix("encoder.")] = value
    return given


def gains(rows: list[Row], before: str, *, general: bool) -> list[str]:
    """What training brought, a line a scope, and a last one if it brought nothing.

    Args:
        rows: of `own_validation`.
        before: the method there that training is compared with.
        general: whether that is the general encoder.

    """
    found = {(row["method"], row["scope"]): float(row["success@1"] or 0) for row in rows}
    scopes = [scope for method, scope in found if method == "trained" and (before, scope) in found]
    first = "the general encoder" if general else "the start"
    how = "at the start" if before == "start" else f"by {first}"
    lines = [
        f"{scope}: success@1 {found[before, scope]:.3f} {how}, {found['trained', scope]:.3f} trained "
        f"({found['trained', scope] - found[before, scope]:+.3f})"
        for scope in scopes
    ]
    if scopes and all(found["trained", scope] <= found[before, scope] for scope in scopes):
        lines.append(f"training brought nothing here: {first} does as well")
    return lines
