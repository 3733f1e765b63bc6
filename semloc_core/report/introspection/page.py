"""The page on a study of explanations: which classes matter, who says so, and who can be trusted."""

from __future__ import annotations

from collections import Counter

from semloc_core import __version__
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.introspection import ABLATION, Introspection, matrices, most_faithful, overall, typical_query
from semloc_core.report.introspection import sections, trust
from semloc_core.report.introspection.hypotheses import NAMES, hypotheses
from semloc_core.report.page import Fact, Page, Section

INTRODUCTION = (
    "A localiser tells a robot where it is by comparing the objects around it (a couch, a plant, …) with those around "
    "every place of a map made before. It is a trained network, and a network can be right for bad reasons. This "
    "page asks "
    "it why: which objects and which classes of objects its answers rest on.",
    "Two ways lead to an answer. One takes all objects of a class away and looks at what becomes of localisation "
    "(ablation). The other asks explainers, methods that give every object a score for one answer; they can be "
    "wrong too, "
    "so they are tested against controls and against each other. Each training is repeated: what differs between "
    "runs is "
    "chance, not knowledge.",
)
TERMS = (
    ("Place", "A patch of free floor: a node of the scene graph. Neighbouring places are joined where one can walk."),
    ("Similarity", "How alike two places are to the network: the cosine of their embeddings, at most 1."),
    ("PR-AUC", "Area under the precision–recall curve over all pairs of query and map place; 1 is perfect."),
    ("Right", f"A map place within {MATCH_RADIUS_M:g} m of where the query truly is."),
    (
        "Importance",
        "An object's part of an explainer's scores (magnitudes that sum to 1 at a place), mean over places.",
    ),
    (
        "Necessity Δ⁺, sufficiency Δ⁻",
        "Change of the similarity when the objects ranked first are removed, or all others.",
    ),
    ("Characterisation score", "Harmonic mean of Δ⁺ and 1 - Δ⁻, on similarity scaled to 0…1; high is good."),
    (
        "Ablation",
        "All objects of a class are taken out of map and query, and PR-AUC is taken again; nothing is trained.",
    ),
    ("Saliency", "An explainer: how steeply the similarity changes with what an object is."),
    (
        "Integrated gradients",
        "An explainer: that slope, added up on the way from objects of no class to the real ones.",
    ),
    (
        "Shapley sampling, class shapley",
        "Explainers: what an object, or a whole class, adds when it joins, on average over who is there already; "
        "sampled, and exact.",
    ),
    ("Attention", "An explainer: the weights by which the network itself sums up what is around."),
    (
        "Kendall's W",
        "Agreement of several rankings: 1 where all are the same; m rankings at random have 1/m on average.",
    ),
    (
        "Bootstrap interval",
        "Where the figure would lie in 95 of 100 like studies: places drawn anew, in squares of 4 m.",
    ),
    ("Spearman's ρ", "Rank correlation of two lists, -1 to 1; in brackets its 95 % interval."),
)


def introspection_page(found: Introspection, name: str) -> Page:
    """The page: the same bytes for the same study.

    Args:
        found: the study.
        name: what to call the graph.

    """
    runs, methods = found.runs, list(found.methods)
    first = runs[0]
    of_places = matrices(first)
    listed: list[Section | None] = [
        sections.rankings(runs, methods),
        sections.importance(first, methods),
        *([sections.shift(runs, "attention" if "attention" in methods else methods[0])] if methods else []),
        trust.fidelity(found),
        trust.sanity(found),
        sections.plan(first, typical_query(first)),
        trust.agreement(found),
        trust.frequency(found),
        *([hypotheses(found.hypotheses)] if found.hypotheses else []),
        sections.place_query_matrices(of_places),
    ]
    model = first.model
    return Page(
        title=f"Why the localiser says so: {name}",
        introduction=(*INTRODUCTION, _outcome(found)),
        facts=[
            Fact(f"{len(runs)}", "trainings"),
            Fact(f"{first.query.n_places:,}", "places"),
            Fact(f"{first.query.n_objects:,}", f"objects of {len(first.frequency)} classes"),
            Fact(f"{len(first.introspection.places):,}", "places explained a run"),
            Fact(f"{of_places.pr_auc[model.encoder.name]:.2f}", "PR-AUC on held-out places, first run"),
            Fact(first.ranking(ABLATION)[0], "costs most when removed, first run"),
        ],
        sections=[section for section in listed if section is not None],
        terms=TERMS,
        provenance=(
            ("Graph", f"{name}: {first.query.n_places} places, {first.query.n_objects} objects"),
            ("Models", "; ".join(f"seed {run.seed}: {run.model.hash}" for run in runs)),
            ("Encoder", model.encoder.name),
            ("Labelspace", f"{model.labelspace.name}: {len(model.labelspace)} classes, {model.labelspace.hash}"),
            ("Explainers", ", ".join(map(sections.plain, methods))),
            ("Software", f"semloc {__version__}"),
        ),
    )


def _outcome(found: Introspection) -> str:
    """What came out, in a paragraph."""
    said = []
    if found.methods:
        best = most_faithful(found.runs, found.methods)
        rows = [row for row in found.controls if row["method"] == best and row["scope"] == "against random"]
        beats = f", {rows[0]['verdict']} than a random one" if rows else ""
        said.append(f"Of the explainers {sections.plain(best)} is the most faithful{beats}.")
    firsts = Counter(run.ranking(ABLATION)[0] for run in found.runs)
    name, times = min(firsts.items(), key=lambda item: (-item[1], item[0]))
    said.append(f"Taking away {name} costs most for its number in {times} of {len(found.runs)} trainings.")
    verdicts = overall(found.hypotheses)
    if verdicts:
        told = "; ".join(f"{NAMES[number]}: {verdict}" for number, verdict in verdicts.items())
        said.append(f"Of what the paper expects, {told}.")
    return "What came out: " + " ".join(said)
