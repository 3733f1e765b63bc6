"""The page on one replay: where the robot was, where the answers put it, how sure they were and what carried them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from semloc_core import __version__
from semloc_core.config import MATCH_RADIUS_M
from semloc_core.map_database import LoadedMap
from semloc_core.report.colours import ClassLooks
from semloc_core.report.floor_plan import Plan
from semloc_core.report.page import Fact, Page, Section
from semloc_core.report.replay import sections
from semloc_core.report.replay.data import ReplayData
from semloc_core.text import percent

BUILDINGS = 6
"""Buildings drawn at most."""
INTRODUCTION = (
    "A robot walks through a building and keeps a scene graph: a list of the objects it has recognised (a couch, a "
    "plant, …) and of the places, patches of free floor, from which they can be seen. At every update the localiser "
    "compares the objects around the robot with those around every place of a map made before, and answers with the "
    "places that are most alike. It uses what things are and how they are connected, no camera pictures.",
    "This page shows how one such walk went. Each figure has a sentence on what to see in it, and its figures below.",
)
TERMS = (
    ("Place", "A patch of free floor: a node of the scene graph. Neighbouring places are joined where one can walk."),
    ("Answer", "What the localiser said to one update: the places of the map most like the robot's, best first."),
    ("Top match", "The first place of an answer."),
    (
        "Right",
        f"Within {MATCH_RADIUS_M:g} m of where the robot truly was, in the same building and on the same storey.",
    ),
    ("success@N", "Share of all answers with a right place among their first N. No answer counts as a wrong one."),
    ("Cosine similarity", "How alike two places are to the encoder: 1 is the same, 0 has nothing in common."),
    ("Probability", "The localiser's own estimate that the top match is right."),
    (
        "Status",
        "match: the answer is accepted; ambiguous: it is not, places far apart are about as likely; unknown: there "
        "was nothing to compare; no_graph: updates were missing.",
    ),
    ("Class share", "How much of the comparison one class of objects carried. An answer's shares sum to 1."),
)


def class_order(data: ReplayData, plans: Sequence[Plan]) -> list[str]:
    """Classes by what they carried in the replay, then by how many the map has."""
    carried: Counter[str] = Counter()
    for attributed in data.shares:
        carried.update(attributed.classes)
    present: Counter[str] = Counter()
    for plan in plans:
        present.update({name: len(points) for name, points in plan.objects.items()})
    names = set(carried) | set(present)
    return sorted(names, key=lambda name: (-carried[name], -present[name], name))


def shown_plans(data: ReplayData, loaded: LoadedMap) -> list[Plan]:
    """The buildings that the robot was in, then those that answers named most; the map's first if there are none."""
    visits: Counter[str] = Counter(p.truth[0] for p in data.points if p.truth is not None)
    named: Counter[str] = Counter(p.match.map for p in data.points if p.match is not None)
    touched = sorted(set(visits) | set(named), key=lambda name: (-visits[name], -named[name], name))
    return [Plan.of(loaded.graph(name), name) for name in (touched or loaded.buildings)[:BUILDINGS]]


def replay_page(data: ReplayData, loaded: LoadedMap, results_name: str) -> Page:
    """The page: the same bytes for the same results and map.

    Args:
        data: of the replay, see `semloc_core.report.replay.data.read_results`.
        loaded: the map that answered, with its scene graphs.
        results_name: what to call the results.

    """
    plans = shown_plans(data, loaded)
    classes = ClassLooks(loaded.model.labelspace.classes, class_order(data, plans))
    found: list[Section | None] = [
        sections.buildings(plans, classes, len(loaded.buildings)),
        sections.where(data, plans),
        sections.success(data),
        sections.confidence(data),
        sections.statuses(data),
        sections.shares(data, classes),
        sections.confusions(data, plans),
        sections.latency(data),
    ]
    model = loaded.model
    return Page(
        title=f"Replay of {results_name} against the map {loaded.name}",
        introduction=INTRODUCTION,
        facts=_facts(data),
        sections=[section for section in found if section is not None],
        terms=TERMS,
        provenance=(
            ("Results", f"{results_name}: {data.answers} answers{_thinned(data)}"),
            ("Map", f"{loaded.name}: {loaded.n_places} places in {len(loaded.buildings)} building(s), {loaded.hash}"),
            ("Model", f"encoder {model.encoder.name}, {model.hash}"),
            ("Labelspace", f"{model.labelspace.name}: {len(model.labelspace)} classes, {model.labelspace.hash}"),
            ("Software", f"semloc {__version__}"),
        ),
    )


def _facts(data: ReplayData) -> list[Fact]:
    facts = [Fact(f"{data.answers:,}", "answers")]
    if data.rows:
        total = data.rows[-1]
        facts.append(Fact(sections.share_of(total, "success@1"), f"of top matches within {MATCH_RADIUS_M:g} m"))
        facts.append(Fact(sections.share_of(total, "success@5"), "with a right place among the first 5"))
    facts.append(Fact(percent(data.statuses["match"] / data.answers), "accepted (status match)"))
    if data.rows and data.rows[-1]["precision"] is not None:
        facts.append(Fact(sections.share_of(data.rows[-1], "precision"), "of the accepted ones right"))
    known = [p.match.similarity for p in data.points if p.match is not None]
    if known:
        facts.append(Fact(f"{np.median(known):.2f}", "similarity of the top match, median"))
    if data.p50_ms is not None:
        facts.append(Fact(f"{data.p50_ms:.1f} ms", "latency, median"))
    return facts


def _thinned(data: ReplayData) -> str:
    return f", every {data.points.stride}th drawn" if data.points.stride > 1 else ""
