"""Why an answer was given: what is published with it."""

from __future__ import annotations

import numpy as np
import torch

from semloc_core.config import LocaliserConfig
from semloc_core.errors import SemlocError
from semloc_core.explain.explainers.by_name import explain
from semloc_core.explain.fidelity import own_fidelity
from semloc_core.explain.layout_scores import LAYOUT, layout_attributions
from semloc_core.explain.scores import class_scores, object_scores
from semloc_core.explain.similarity import SimilarityQuery
from semloc_core.matching import Located
from semloc_core.wire import ClassAttributions, MethodAttributions

EXPLAINER_SEED = 0
"""Explainers that sample start from it at every answer: a replay explains as the node did, also from its middle."""


def answer_evidence(located: Located) -> ClassAttributions | None:
    """What the decision rests on, exactly; None where nothing was put to the test."""
    if located.evidence is None:
        return None
    said = layout_attributions(located.evidence, located.map.model.labelspace.classes)
    return _message(located, said, said.walls)


def due(located: Located, config: LocaliserConfig, last_ns: int | None) -> bool:
    """Whether an explanation is due for an answer, by ``explain_rate_hz``, after one for the stamp ``last_ns``."""
    rate, now = config.explain_rate_hz, located.query.stamp_ns
    if located.best_row is None or rate <= 0:
        return False
    if config.explainer == LAYOUT and located.evidence is None:
        return False  # the place was not put to the test that is to be explained
    # Half a millisecond of grace: stamps of a steady stream jitter by rounding.
    return last_ns is None or not last_ns <= now < last_ns + 1e9 / rate - 5e5


def explain_answer(located: Located, config: LocaliserConfig) -> ClassAttributions:
    """Say which classes and objects carried an answer, and how well that holds when put to the test.

    Needs the answer alone: any thread or process can do it, whatever updates have come since.

    Args:
        located: the answer.
        config: says by which explainer.

    Raises:
        SemlocError: there is nothing to explain: the answer has no match, or was not put to the test that is to
            be explained.

    """
    query = located.query
    if located.best_row is None or query.batch is None or query.encoded is None:
        raise SemlocError(f"expected an answer with a match to explain (got {located.matches.status})")
    if config.explainer == LAYOUT:
        evidence = answer_evidence(located)
        if evidence is None:
            raise SemlocError("expected an answer that was put to the test by layout (got one that was not)")
        return evidence
    target = torch.from_numpy(located.map.embeddings[located.best_row])
    question = SimilarityQuery.from_encoder(
        located.map.model.encoder,
        query.batch,
        target,
        query.class_names,
        query.encoded,
        queries=located.map.queries,
    )
    scores = explain(question, config.explainer, np.random.default_rng(EXPLAINER_SEED))
    said = MethodAttributions(
        method=scores.method,
        classes=class_scores(scores),
        objects=object_scores(scores),
        fidelity=own_fidelity(question, scores),
        completeness_gap=scores.completeness_gap,
    )
    return _message(located, said, scores.unattributed)


def _message(located: Located, said: MethodAttributions, unattributed: float | None) -> ClassAttributions:
    query, best = located.query, located.matches.matches[0]
    return ClassAttributions(
        schema="semloc/class_attributions/1",
        stamp_ns=query.stamp_ns,
        frame_id=located.matches.frame_id,
        seq=query.seq,
        query_place=query.place,
        match_map=best.map,
        match_place=best.place,
        method=said.method,
        classes=said.classes,
        objects=said.objects,
        unattributed=unattributed,
        fidelity=said.fidelity,
        completeness_gap=said.completeness_gap,
        missed=said.missed,
        walls=said.walls,
    )
