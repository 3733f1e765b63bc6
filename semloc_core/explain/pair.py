"""Everything that can be said of one pair, a query and a place of the map: the answer to an ``explain_request``."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
import torch

from semloc_core.config import LocaliserConfig
from semloc_core.encoding import PerturbedEncoder
from semloc_core.errors import ConfigError, GraphError, MapError, SemlocError
from semloc_core.explain.counterfactual import counterfactual, why_not
from semloc_core.explain.explainers.by_name import CONTROLS, EXPLAINERS, check_methods, explain
from semloc_core.explain.fidelity import said_by
from semloc_core.explain.layout_scores import LAYOUT, layout_attributions
from semloc_core.explain.similarity import SimilarityQuery
from semloc_core.explain.without_class import without_classes
from semloc_core.map_database import LoadedMap
from semloc_core.matching import Evidence, Located, confidence, evidence_at, verifier_of
from semloc_core.wire import ExplainRequest, Explanation, PlaceEvidence

ACCEPT_PROBABILITY = LocaliserConfig().accept_probability
SEED = 0
"""Explainers that sample start from it at every request, so that the same question has the same answer."""


def answer_query(
    located: Located, request: ExplainRequest, accept_probability: float = ACCEPT_PROBABILITY
) -> Explanation:
    """Answer a request on an answer: needs no graph, so any process can do it; what can't be said is in ``error``.

    Args:
        located: the answer for the place asked about (`semloc_core.localiser.Localiser.ask`).
        request: its place, building and methods count.
        accept_probability: the localiser's option.

    """
    try:
        row = find_row(located, request.map, request.place)
        return explain_pair(
            located,
            row,
            methods=request.methods,
            stamp_ns=request.stamp_ns,
            seq=request.seq,
            accept_probability=accept_probability,
        )
    except SemlocError as error:
        return Explanation(
            schema="semloc/explanation/1",
            stamp_ns=request.stamp_ns,
            frame_id=located.matches.frame_id,
            seq=request.seq,
            query_place=request.query_place,
            match_map=request.map,
            match_place=request.place,
            similarity=None,
            methods=[],
            error=str(error),
        )


def find_row(located: Located, building: str | None, place: str | None) -> int:
    """The row of the map place to explain.

    Args:
        located: an answer.
        building: None: any building.
        place: None: the answer's top match. Where a building is given, its first in the answer; if none of it is
            listed there, its most similar place.

    Raises:
        GraphError: the query was not embedded.
        MapError: no such place or building, or several buildings have a place of this id.

    """
    loaded, query = located.map, located.query
    if query.encoded is None or located.best_row is None:
        raise GraphError(f"expected a query to explain (got none: {query.reason or 'no graph or no map'})")
    if place is None and building is None:
        return located.best_row
    if place is None:
        for row in _listed(located):
            if loaded.buildings[int(loaded.building_index[row])] == building:
                return row
        return int(loaded.search(query.encoded.embedding[0].numpy(), 1, [str(building)])[0][0])
    if building is not None:
        return loaded.row(building, place)
    rows = [row for row, name in enumerate(loaded.place_ids) if name == place]
    if len(rows) != 1:
        names = ", ".join(loaded.buildings[int(loaded.building_index[row])] for row in rows) or "none"
        which = ", or its building too (--map-name, or a request's map)" if rows else ""
        raise MapError(f"expected a place id that one building of the map has{which} (got {place!r}: {names})")
    return rows[0]


def _listed(located: Located) -> list[int]:
    """Rows of an answer's matches, best first."""
    return [located.map.row(match.map, match.place) for match in located.matches.matches]


def check_asked(methods: Sequence[str]) -> None:
    """Raise ConfigError where a name is no explainer's that a pair can be explained by."""
    check_methods(methods, [*EXPLAINERS, LAYOUT, *CONTROLS])


def asked_methods(located: Located, methods: Sequence[str] | None) -> list[str]:
    """The methods to explain a pair by; None: all that apply to the answer.

    Raises:
        ConfigError: no such explainer, or ``layout`` of an answer that was not put to the test.

    """
    methods = list(EXPLAINERS) + [LAYOUT] * (located.evidence is not None) if methods is None else list(methods)
    check_asked(methods)
    if LAYOUT in methods and located.evidence is None:
        raise ConfigError("expected layout asked of an answer that was put to the test (got one that was not)")
    return methods


def evidence_of(located: Located, row: int) -> Evidence | None:
    """The test taken apart at any place of the map; None for an answer that was not put to it."""
    verifier = verifier_of(located.map)
    if located.evidence is None or verifier is None or row == located.evidence.row:
        return located.evidence
    return evidence_at(verifier, located.evidence.fragment, row)


def place_evidence(loaded: LoadedMap, evidence: Evidence) -> PlaceEvidence:
    """The same as messages have it."""
    said = layout_attributions(evidence, loaded.model.labelspace.classes)
    return PlaceEvidence(
        map=loaded.buildings[int(loaded.building_index[evidence.row])],
        place=loaded.place_ids[evidence.row],
        score=evidence.score,
        objects=said.objects,
        missed=said.missed or [],
        walls=-evidence.walls,
    )


def probability_of(located: Located, row: int) -> float | None:
    """P(a place of the map is right) as an answer has it: of one that it does not list, by what came of the test.

    Neither a filter nor a hint has a say in that. None for an answer that was not put to the test.
    """
    matches, loaded = located.matches, located.map
    for match in (*matches.matches, *matches.rivals):
        if loaded.row(match.map, match.place) == row:
            return match.probability
    verifier, encoded = verifier_of(loaded), located.query.encoded
    if located.evidence is None or verifier is None or encoded is None:
        return None
    fragment = located.evidence.fragment
    found = verifier.verify(fragment, loaded.index.everywhere(encoded.embedding[0].numpy(), 1)[2])
    if found is None:
        return 0.0
    # Places that can't be right together share what there is: all that were tested are asked beside it.
    beside = np.array([*(other for other in found.rows.tolist() if other != row), row], dtype=np.int64)
    answers = confidence(found, fragment, verifier.mapped).answers
    return float(answers.probability(verifier.mapped, beside)[-1])


def explain_pair(
    located: Located,
    row: int,
    *,
    methods: Sequence[str] | None = None,
    stamp_ns: int = 0,
    seq: int = 0,
    seed: int = SEED,
    accept_probability: float = ACCEPT_PROBABILITY,
) -> Explanation:
    """Explain a query and a place of the map by several methods, with a counterfactual and a contrast to the top match.

    The top match is the answer's, after verification by layout where that is on. The method ``layout`` takes that test
    apart at the place, which is put to it if it was not, and so does the contrast at both; the other methods, and the
    counterfactual, are about the embedding's similarity. Of the published place: what the answer would be without each
    class.

    Args:
        located: an answer with an embedded query.
        row: row of the place in the map.
        methods: explainers; None: all, ``layout`` where the answer was put to the test.
        stamp_ns: of the message, nanoseconds.
        seq: of the message.
        seed: of explainers that sample; each starts from it, so that a method says the same whoever is asked beside it.
        accept_probability: the localiser's option: from which on an answer is a ``match``.

    Raises:
        ConfigError: no such explainer, or ``layout`` of an answer that was not put to the test.
        GraphError: the query was not embedded.

    """
    methods = asked_methods(located, methods)
    loaded, query = located.map, located.query
    if query.batch is None or query.encoded is None:
        raise GraphError(f"expected a query to explain (got none: {query.reason})")
    encoder, names = loaded.model.encoder, query.class_names
    target = torch.from_numpy(loaded.embeddings[row])
    question = SimilarityQuery.from_encoder(encoder, query.batch, target, names, query.encoded)
    evidence = evidence_of(located, row)
    said = []
    for method in methods:
        if method == LAYOUT and evidence is not None:
            said.append(layout_attributions(evidence, loaded.model.labelspace.classes))
            continue
        said.append(said_by(question, explain(question, method, np.random.default_rng(seed))))
    z = query.encoded.embedding[0].numpy()
    perturbed = PerturbedEncoder(encoder, query.batch)
    contrast = why_not(loaded, perturbed, names, z, row, _listed(located), np.random.default_rng(seed))
    if contrast is not None and evidence is not None and located.evidence is not None:
        both = [place_evidence(loaded, of) for of in (evidence, located.evidence)]
        contrast = msgspec.structs.replace(contrast, evidence=both)
    published = evidence is not None and evidence is located.evidence
    return Explanation(
        schema="semloc/explanation/1",
        stamp_ns=stamp_ns,
        frame_id=located.matches.frame_id,
        seq=seq,
        query_place=query.place,
        match_map=loaded.buildings[int(loaded.building_index[row])],
        match_place=loaded.place_ids[row],
        similarity=question.full,
        methods=said,
        counterfactual=counterfactual(loaded, perturbed, names, z),
        why_not=contrast,
        without=without_classes(located, perturbed, accept_probability) if published else None,
        position=tuple(loaded.positions[row].tolist()),
        probability=probability_of(located, row),
    )
