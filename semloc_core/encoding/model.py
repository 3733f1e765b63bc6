"""A trained encoder with all that its embeddings mean: labelspace, seed, temperature, where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from semloc_core.encoding import checkpoint, place_graph
from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.encoder.base import Encoder
from semloc_core.encoding.place_graph import Batch
from semloc_core.errors import ConfigError, ModelError
from semloc_core.files import write_whole
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.text import short_repr

ROOTS_AT_ONCE = 1024  # places a batch, where each place brings copies of the objects in its reach


@short_repr
@dataclass(eq=False)
class Model:
    """What `semloc train` makes, a map carries and a robot runs.

    Args:
        encoder: the encoder.
        labelspace: what the columns of its features mean.
        seed: the seed that it was trained with.
        temperature: softmax temperature that turns similarities into probabilities.
        provenance: what it was trained on and how; plain JSON.

    Raises:
        ModelError: the labelspace has another number of classes than the encoder, or the temperature is not a
            positive number.

    """

    encoder: Encoder
    labelspace: Labelspace
    seed: int = 0
    temperature: float = 1.0
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.encoder.n_classes != len(self.labelspace):
            raise ModelError(f"expected a labelspace of {self.encoder.n_classes} classes (got {len(self.labelspace)})")
        if not 0 < self.temperature < float("inf"):
            raise ModelError(f"expected a positive temperature (got {self.temperature})")

    @property
    def hash(self) -> str:
        """sha256 (hex) of what decides an answer: encoder, configuration, temperature, class names, tensors.

        Of the content, not of file bytes; seed and provenance are not part of it. Computed anew on each call, since
        weights can be trained on: keep it where it is needed often.
        """
        config = {"encoder": msgspec.to_builtins(self.encoder.config), "temperature": self.temperature}
        return checkpoint.content_hash(self.encoder.name, config, self.labelspace.classes, self._tensors())

    def to_bytes(self) -> bytes:
        """The model file's content (`semloc_core.encoding.checkpoint`); the same model gives the same bytes."""
        header = checkpoint.Header(
            format="semloc/model",
            version=checkpoint.VERSION,
            encoder=self.encoder.name,
            config=msgspec.to_builtins(self.encoder.config),
            labelspace=self.labelspace,
            seed=self.seed,
            temperature=self.temperature,
            provenance=self.provenance,
            hash=self.hash,
        )
        return checkpoint.pack(header, self._tensors())

    @classmethod
    def from_bytes(cls, data: bytes, max_bytes: int = checkpoint.MAX_BYTES) -> Model:
        """Read a model file's content; nothing in it is executed. The encoder is in eval mode.

        Raises:
            ModelError: not a model, truncated, changed, of a later version, too big, tensors missing or too many,
                of other shapes or not finite.

        """
        header, members = checkpoint.unpack(data, max_bytes)
        try:
            with torch.device("meta"):  # shapes without memory: a header can claim any size
                encoder = build_encoder(header.encoder, header.config, len(header.labelspace))
        except ConfigError as error:
            raise ModelError(f"expected a model to build (got: {checkpoint.one_line(error)})") from error
        wanted = encoder.state_dict()
        if missing := wanted.keys() - members.keys():
            raise ModelError(f"expected tensor {min(missing)!r} (got a model without it)")
        if extra := members.keys() - wanted.keys():
            raise ModelError(f"expected {len(wanted)} tensors (got also {checkpoint.one_line(min(extra))})")
        tensors = {
            name: checkpoint.read_tensor(name, members[name], tuple(tensor.shape), _numpy_dtype(tensor))
            for name, tensor in wanted.items()
        }
        if any(name.endswith("running_var") and (array < 0).any() for name, array in tensors.items()):
            raise ModelError("expected variances of at least 0 (got a negative one)")
        encoder.load_state_dict({name: torch.from_numpy(array) for name, array in tensors.items()}, assign=True)
        encoder.eval()
        model = cls(encoder, header.labelspace, header.seed, header.temperature, header.provenance)
        if (found := model.hash) != header.hash:
            raise ModelError(f"expected content of hash {header.hash} (got {found})")
        return model

    def save(self, path: Path | str) -> None:
        """Write the model file, whole or not at all.

        Raises:
            ModelError: the file can't be written.

        """
        try:
            write_whole(path, self.to_bytes())
        except OSError as error:
            raise ModelError(f"expected a path to write the model to (got {path}: {error.strerror})") from error

    @classmethod
    def load(cls, path: Path | str, max_bytes: int = checkpoint.MAX_BYTES) -> Model:
        """Read a model file; errors name it.

        Raises:
            ModelError: as `from_bytes`, or the file can't be read.

        """
        try:
            with Path(path).open("rb") as file:
                data = file.read(max_bytes + 1)
        except OSError as error:
            raise ModelError(f"expected a model file (got {path}: {error.strerror})") from error
        try:
            return cls.from_bytes(data, max_bytes)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error

    def _tensors(self) -> dict[str, NDArray[Any]]:
        """Named weights and buffers."""
        return {name: t.detach().cpu().numpy() for name, t in self.encoder.state_dict().items()}


def load_model(path: Path | str) -> Model:
    """Read a model file: `Model.load`."""
    return Model.load(path)


def embed_batch(model: Model, batch: Batch) -> NDArray[np.float32]:
    """Embeddings of a batch's B places: (B, D) float32. The encoder is run in eval mode, without gradients.

    Raises:
        ModelError: weights so large that a number is not finite, or a batch of other classes or too few hops.

    """
    encoder = model.encoder
    training = encoder.training
    if training:
        encoder.eval()
    try:
        with torch.inference_mode():
            embeddings: NDArray[np.float32] = encoder(batch).cpu().numpy()
    finally:
        if training:
            encoder.train()
    if not np.isfinite(embeddings).all():
        raise ModelError("expected finite embeddings (got NaN or infinity; the model's weights are too large)")
    return embeddings


def embed_graph(model: Model, arrays: GraphArrays, weights: Mapping[str, float] | None = None) -> NDArray[np.float32]:
    """Embeddings of all P places of a building, in the order of ``arrays.place_ids``: (P, D) float32.

    Args:
        model: what embeds.
        arrays: the building.
        weights: object id -> what its features are multiplied by; 1 for those not named. An encoder that counts
            objects (`bag_of_words`, `rings`, `geodesic_attention` and the like) counts one of weight w as w objects.
            `paper` does not (``Encoder.counts_objects``): a fading object would go on passing messages, like a place.
            There weights are left out; an object counts whole until it is taken out of the graph.

    """
    extraction, n_classes = model.encoder.extraction, model.encoder.n_classes
    weights = weights if model.encoder.counts_objects else None
    if arrays.n_places == 0:
        return np.zeros((0, model.encoder.dimension), dtype=np.float32)
    every = np.arange(arrays.n_places)
    at_once = len(every) if extraction.kind == "ego" else ROOTS_AT_ONCE
    batches = (
        place_graph.extract_all(arrays, n_classes, extraction, roots)
        for roots in np.split(every, range(at_once, len(every), at_once))
    )
    return np.concatenate([embed_batch(model, weighted(batch, weights)) for batch in batches])


def weighted(batch: Batch, weights: Mapping[str, float] | None) -> Batch:
    """The batch with the features of its objects multiplied by their weights; see `embed_graph`."""
    if not weights:
        return batch
    of_node = torch.tensor([weights.get(node, 1.0) for node in batch.node_ids], dtype=torch.float32)
    return batch.with_features(batch.features * torch.where(batch.is_object, of_node, 1.0)[:, None])


def embed_places(model: Model, arrays: GraphArrays, roots: NDArray[np.int64]) -> NDArray[np.float32]:
    """Embeddings of some places of a building, ``roots`` (B,) by index: (B, D) float32."""
    extraction = model.encoder.extraction
    if extraction.kind == "ego":
        return embed_graph(model, arrays)[roots]
    return embed_batch(model, place_graph.extract_all(arrays, model.encoder.n_classes, extraction, roots))


def _numpy_dtype(tensor: torch.Tensor) -> np.dtype[Any]:
    return np.dtype(str(tensor.dtype).removeprefix("torch."))
