"""Many variants of one query place embedded at once: features changed, or nodes removed."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache

import torch
from torch import Tensor

from semloc_core.encoding.encoder.base import Encoder
from semloc_core.encoding.encoder.query import QueryEncoder
from semloc_core.encoding.place_graph import Batch, repeat
from semloc_core.encoding.variants.copies import PaperCopies
from semloc_core.encoding.variants.removals import PaperRemovals
from semloc_core.errors import ModelError

NODES_AT_ONCE = 2**13
"""Nodes in one union of copies: beyond a few thousand nothing gets faster, and memory would grow without bound."""


def products(z: Tensor, target: Tensor) -> Tensor:
    """Scalar products of (…, D) with (D,), summed in float64 and rounded once: alike on every processor."""
    return (z.double() @ target.double()).to(z.dtype)


class PerturbedEncoder:
    """Embeds many variants of one query place at once: as one batch, their disjoint union, or by `PaperCopies`.

    Args:
        encoder: in eval mode.
        batch: one query place, N nodes.
        nodes_at_once: variants are encoded in portions of about so many nodes (at least one variant at a time).
        queries: of that encoder, where there is one: removals then go its way where that is the faster one.

    Raises:
        ModelError: a batch of more places than one, or an encoder that is being trained.

    """

    def __init__(
        self,
        encoder: Encoder,
        batch: Batch,
        nodes_at_once: int = NODES_AT_ONCE,
        queries: QueryEncoder | None = None,
    ) -> None:
        if batch.n_roots != 1:
            raise ModelError(f"expected a batch of one query place (got {batch.n_roots})")
        if encoder.training and encoder.trainable:
            raise ModelError("expected an encoder in eval mode (got one in training mode)")
        self.batch = _normal_batch(batch)
        self.dimension = encoder.dimension
        self._encoder = encoder
        self._portion = max(1, nodes_at_once // max(1, batch.n_nodes))
        self._queries = queries
        self._copies = lru_cache(maxsize=4)(self._make_copies)

    def embed(self, features: Tensor | None = None, keep: Tensor | None = None) -> Tensor:
        """Embed K variants; arguments as of `semloc_core.explain.similarity.Similarity`.

        Returns:
            (K, D) float32. Gradients are recorded only where ``features`` wants them.

        Raises:
            ModelError: neither is given, or shapes or types are not as said.

        """
        k = self._check(features, keep)
        if features is None and keep is not None:
            found = self._queries.embed(self.batch, keep.numpy()) if self._queries is not None else None
            if found is not None:
                return torch.from_numpy(found)
            if self._removals is not None:
                return self._removals.embed(keep)
        wants_gradient = features is not None and features.requires_grad
        with torch.inference_mode(False), torch.set_grad_enabled(wants_gradient):
            parts = [
                self._embed(features, keep, start, min(start + self._portion, k))
                for start in range(0, k, self._portion)
            ]
            return parts[0] if len(parts) == 1 else torch.cat(parts)

    def gradient(self, features: Tensor, target: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Scalar product with a target, and its gradient by the features of some nodes.

        Args:
            features: (K, N, C) float32.
            target: (D,) float32.
            rows: (R,) int64, which nodes.

        Returns:
            (K,) and (K, R, C), both without a graph of their own.

        Raises:
            ModelError: as of `embed`.

        """
        if self._paper is None:
            with torch.inference_mode(False), torch.enable_grad():
                leaf = features.detach().clone().requires_grad_(True)
                values = self.embed(leaf) @ target
                (gradient,) = torch.autograd.grad(values.sum(), leaf)
            return values.detach(), gradient[:, rows]
        starts = range(0, self._check(features, None), self._portion)
        found = [self._paper.gradient(features[i : i + self._portion], target, rows) for i in starts]
        return torch.cat([value for value, _ in found]), torch.cat([gradient for _, gradient in found])

    def _embed(self, features: Tensor | None, keep: Tensor | None, start: int, stop: int) -> Tensor:
        if self._paper is not None and not torch.is_grad_enabled():
            part = slice(start, stop)
            return self._paper.embed(
                features[part] if features is not None else None, keep[part] if keep is not None else None
            )
        copies, order = self._copies(stop - start)
        if features is not None:
            copies = copies.with_features(features[start:stop].flatten(0, 1).index_select(0, order))
        kept = keep[start:stop].flatten().index_select(0, order) if keep is not None else None
        return self._encoder(copies, keep=kept)  # type: ignore[no-any-return]  # nn.Module's call is untyped

    @cached_property
    def _paper(self) -> PaperCopies | None:
        return PaperCopies(self._encoder, self.batch) if PaperCopies.fits(self._encoder, self.batch) else None

    @cached_property
    def _removals(self) -> PaperRemovals | None:
        paper = self._paper
        return PaperRemovals(paper.encoder, self.batch, paper) if paper is not None else None

    def _make_copies(self, k: int) -> tuple[Batch, Tensor]:
        """The union of k copies, and for each of its rows where the node is in (k, N) order."""
        copies, rows = repeat(self.batch, k)
        order = torch.empty(rows.numel(), dtype=torch.int64)
        order[rows.flatten()] = torch.arange(rows.numel())
        return copies, order

    def _check(self, features: Tensor | None, keep: Tensor | None) -> int:
        n, c = self.batch.features.shape
        given = [x for x in (features, keep) if x is not None]
        if not given:
            raise ModelError("expected features or nodes to keep (got neither)")
        k = int(given[0].shape[0])
        if features is not None and (tuple(features.shape) != (k, n, c) or features.dtype != torch.float32):
            raise ModelError(
                f"expected float32 features ({k}, {n}, {c}) (got {features.dtype} {tuple(features.shape)})"
            )
        if keep is not None and (tuple(keep.shape) != (k, n) or keep.dtype != torch.bool):
            raise ModelError(f"expected a boolean mask ({k}, {n}) (got {keep.dtype} {tuple(keep.shape)})")
        return k


def _normal_batch(batch: Batch) -> Batch:
    tensors = (batch.features, batch.edge_index, batch.edge_length, batch.is_object, batch.graph)
    if not any(tensor.is_inference() for tensor in tensors):
        return batch
    features, edge_index, edge_length, is_object, graph = map(normal, tensors)
    return replace(
        batch, features=features, edge_index=edge_index, edge_length=edge_length, is_object=is_object, graph=graph
    )


def normal(tensor: Tensor) -> Tensor:
    """A tensor made in inference mode can't be saved for a backward pass: copy such a one."""
    with torch.inference_mode(False):
        return tensor.clone() if tensor.is_inference() else tensor
