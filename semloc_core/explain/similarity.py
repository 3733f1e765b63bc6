"""What every explainer asks: the similarity of a changed query to one map place.

A function and not a model class, so that a model from elsewhere can be explained through it too. Zeroing a feature
and removing a node are different things: a zeroed node still counts in a sum and in a softmax.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from semloc_core.encoding import (
    FEW,
    NODES_AT_ONCE,
    Batch,
    Encoded,
    Encoder,
    PerturbedEncoder,
    QueryEncoder,
    normal,
    products,
)
from semloc_core.errors import ModelError
from semloc_core.explain.intrinsic import intrinsic_scores
from semloc_core.explain.scores import ObjectScores
from semloc_core.text import short_repr


class Similarity(Protocol):
    """Similarity of K perturbed queries to one map place."""

    def __call__(self, features: Tensor | None = None, keep: Tensor | None = None) -> Tensor:
        """Evaluate K variants of the query; one of the two must be given, and both must agree in K.

        Args:
            features: (K, N, C) float32 node features; None: the query's own. Gradients flow to them.
            keep: (K, N) bool; nodes where it is false are removed from that variant. None: all stay.

        Returns:
            (K,) similarities.

        """


@short_repr
@dataclass(frozen=True, eq=False)
class SimilarityQuery:
    """One query place and one map place, for explainers to ask about.

    Args:
        ids: O object ids.
        classes: O class names.
        rows: (O,) int64, which nodes the objects are.
        features: (N, C) float32, the query as it is.
        function: the similarity under perturbation; cosine for unit embeddings.
        gradient: (K, N, C) features -> (K,) similarities and (K, O, C), their gradients by the objects' features; None:
            by automatic differentiation of ``function``.
        intrinsic: what the model itself says of its objects (attention), where it says anything.
        known: the similarity of the query as it is, where the caller has it already.

    """

    ids: tuple[str, ...]
    classes: tuple[str, ...]
    rows: Tensor
    features: Tensor
    function: Similarity
    gradient: Callable[[Tensor], tuple[Tensor, Tensor]] | None = None
    intrinsic: Callable[[], ObjectScores] | None = None
    known: float | None = None

    def __post_init__(self) -> None:
        assert len(self.ids) == len(self.classes) == len(self.rows), (len(self.ids), len(self.classes))
        assert self.features.ndim == 2, self.features.shape

    @classmethod
    def from_encoder(
        cls,
        encoder: Encoder,
        batch: Batch,
        target: Tensor,
        class_names: Sequence[str],
        encoded: Encoded | None = None,
        nodes_at_once: int = NODES_AT_ONCE,
        queries: QueryEncoder | None = None,
    ) -> SimilarityQuery:
        """Ask an encoder.

        Args:
            encoder: in eval mode.
            batch: one query place, N nodes.
            target: (D,) embedding of the map place.
            class_names: N names; those of places are not read.
            encoded: what the encoder made of ``batch``, where that is known: saves a pass.
            nodes_at_once: see `PerturbedEncoder`.
            queries: see `PerturbedEncoder`.

        Raises:
            ModelError: as of `PerturbedEncoder`, or a target of another dimension.

        """
        target = normal(target)

        def intrinsic() -> ObjectScores:
            if encoded is not None:
                return intrinsic_scores(encoder, batch, encoded, class_names, target)
            with torch.inference_mode():
                return intrinsic_scores(encoder, batch, encoder.encode(batch), class_names, target)

        known = float(products(encoded.embedding[0], target)) if encoded is not None else None
        perturbed = PerturbedEncoder(encoder, batch, nodes_at_once, queries)
        return cls.from_perturbed(perturbed, target, class_names, intrinsic, known)

    @classmethod
    def from_perturbed(
        cls,
        perturbed: PerturbedEncoder,
        target: Tensor,
        class_names: Sequence[str],
        intrinsic: Callable[[], ObjectScores] | None = None,
        known: float | None = None,
    ) -> SimilarityQuery:
        """Ask about the scalar product with a target, by what embeds the query's variants.

        Args:
            perturbed: several queries may share it, and so its unions.
            target: (D,), any direction: the difference of two map places' embeddings contrasts them.
            class_names: N names; those of places are not read.
            intrinsic: see the class.
            known: see the class.

        Raises:
            ModelError: a target of another dimension.

        """
        if tuple(target.shape) != (perturbed.dimension,):
            raise ModelError(f"expected a target of {perturbed.dimension} numbers (got shape {tuple(target.shape)})")
        target = normal(target)

        def similarity(features: Tensor | None = None, keep: Tensor | None = None) -> Tensor:
            with torch.inference_mode(False):
                return products(perturbed.embed(features, keep), target)

        batch = perturbed.batch
        rows = np.flatnonzero(batch.is_object.numpy())
        numbers = rows.tolist()
        return cls(
            ids=tuple([batch.node_ids[i] for i in numbers]),
            classes=tuple([class_names[i] for i in numbers]),
            rows=(objects := torch.from_numpy(rows)),
            features=batch.features,
            function=similarity,
            gradient=lambda features: perturbed.gradient(features, target, objects),
            intrinsic=intrinsic,
            known=known,
        )

    @property
    def n_objects(self) -> int:
        """O."""
        return len(self.ids)

    @cached_property
    def full(self) -> float:
        """Similarity of the query as it is."""
        if self.known is not None:
            return self.known
        with torch.no_grad():
            return float(self.function(self.features[None])[0])

    @cached_property
    def class_players(self) -> tuple[tuple[str, ...], NDArray[np.int64]]:
        """Names of the classes present, sorted, and (O,) which of them each object has."""
        names = tuple(sorted(set(self.classes)))
        number = {name: i for i, name in enumerate(names)}
        return names, np.array([number[name] for name in self.classes], dtype=np.int64)

    def of_objects(self, present: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Similarity when only some objects are there; places always stay.

        Args:
            present: (K, O) bool. Rows that are equal are evaluated once.

        Returns:
            (K,) float64.

        """
        if len(present) == 0:
            return np.zeros(0)
        first, back = _distinct_rows(present)
        keep = torch.ones(len(first), self.features.shape[0], dtype=torch.bool)
        keep[:, self.rows] = torch.from_numpy(present[first])
        with torch.no_grad():
            values = self.function(None, keep)
        found: NDArray[np.float64] = values.detach().double().cpu().numpy()[back]
        return found

    def of_features(self, features: Tensor) -> tuple[NDArray[np.float64], Tensor]:
        """Similarity under K feature matrices (K, N, C), and its gradient by the objects' features (K, O, C)."""
        if self.gradient is not None:
            values, gradient = self.gradient(features)
            return values.double().cpu().numpy(), gradient
        with torch.inference_mode(False), torch.enable_grad():
            leaf = features.detach().clone().requires_grad_(True)
            values = self.function(leaf, None)
            (gradient,) = torch.autograd.grad(values.sum(), leaf)
        return values.detach().double().cpu().numpy(), gradient[:, self.rows]

    def scores(
        self,
        method: str,
        values: NDArray[np.float64],
        standard_error: NDArray[np.float64] | None = None,
        completeness_gap: float | None = None,
    ) -> ObjectScores:
        """Wrap (O,) values as this query's scores."""
        return ObjectScores(
            method=method,
            ids=self.ids,
            classes=self.classes,
            scores=np.asarray(values, dtype=np.float64),
            standard_error=standard_error,
            completeness_gap=completeness_gap,
        )


def _distinct_rows(present: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of (K, O): which rows are one of each (U,), and which of these each row is (K,)."""
    if len(present) <= FEW:  # looking would cost more than it saves
        return np.arange(len(present)), np.arange(len(present))
    packed = np.packbits(present, axis=1)
    if packed.shape[1] == 0:  # no object: every variant is the query itself
        packed = np.zeros((len(present), 1), dtype=np.uint8)
    _, first, back = np.unique(
        np.ascontiguousarray(packed).view(f"V{packed.shape[1]}")[:, 0], return_index=True, return_inverse=True
    )
    return first, back.reshape(-1)
