"""The paper's encoder: class one-hot, sum message passing, GATv2, a unit vector (Section IV-B.1)."""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
import torch
import torch.nn.functional as F
from msgspec import Meta
from torch import Tensor, nn

from semloc_core.encoding.encoder.base import Encoded, Encoder, start_generator
from semloc_core.encoding.encoder.layers import Linear, SumLayer, TrimmedEdges, trim
from semloc_core.encoding.encoder.paper.credit import roll_out
from semloc_core.encoding.encoder.paper.gatv2 import Attention, GATv2
from semloc_core.encoding.place_graph import Batch
from semloc_core.encoding.place_graph.extraction import Extraction

TINY = 1e-12  # a zero vector stays zero


class PaperConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the paper's encoder; the defaults are "our model" of its Table III, the ranges cover its rows.

    Args:
        layers: message-passing layers before GATv2.
        hidden: width of a hidden state, and of one GATv2 head.
        heads: attention heads, concatenated.
        gat: whether there is a GATv2 block ("No GAT block" in Table III).
        self_loops: whether GATv2 attends to the place itself. The paper does not say; on, as in PyG.
        dimension: numbers per embedding.
        visibility_radius_m: an object is seen from places up to this geodesic distance from its parent place.
            The paper takes visibility edges as given; metres.

    """

    layers: Annotated[int, Meta(ge=1, le=3)] = 2
    hidden: Annotated[int, Meta(ge=1, le=1024)] = 64
    heads: Annotated[int, Meta(ge=1, le=16)] = 3
    gat: bool = True
    self_loops: bool = True
    dimension: Annotated[int, Meta(ge=2, le=1024)] = 32
    visibility_radius_m: Annotated[float, Meta(gt=0, le=100)] = 4.0


class PaperEncoder(Encoder):
    """Linear to ``hidden`` and ELU, ``layers`` × (sum, tanh, batch norm), GATv2, linear to ``dimension``, unit norm.

    A place's features are zero ("aggregation point"), so its first state is ELU of the projection's bias. Where
    the paper is silent: the projection has a bias, each message-passing layer has a weight for the node's own
    state (`SumLayer`), GATv2 has self-loops and no activation after it, and the ego graph reaches as many hops as
    there are layers, GATv2 among them, so that the embedding equals that of a whole-graph pass.

    Each layer computes only the rows that the next one reads: with T layers, layer l = 0 … T-1 those within
    T-1-l hops of a root, so that a query costs what its own embedding needs. In training mode batch norm takes its
    statistics from the rows computed.
    """

    name: ClassVar[str] = "paper"
    config_type = PaperConfig
    counts_objects: ClassVar[bool] = False
    config: PaperConfig

    def __init__(self, config: PaperConfig | None, n_classes: int, generator: torch.Generator | None = None) -> None:
        super().__init__(config, n_classes)
        generator = start_generator(generator)
        c = self.config
        self.project = Linear(n_classes, c.hidden)
        self.project.reset_parameters(generator)
        self.layers = nn.ModuleList(SumLayer(c.hidden, c.hidden, generator) for _ in range(c.layers))
        self.gat = GATv2(c.hidden, c.hidden, c.heads, generator, c.self_loops) if c.gat else None
        self.embed = Linear(c.hidden * (c.heads if c.gat else 1), c.dimension)
        self.embed.reset_parameters(generator)

    @property
    def hops(self) -> int:
        """T, layers that read neighbours, GATv2 among them."""
        return self.config.layers + self.config.gat

    @property
    def extraction(self) -> Extraction:
        """An ego graph of as many hops as there are layers."""
        return Extraction("ego", self.hops, self.config.visibility_radius_m)

    @property
    def dimension(self) -> int:
        """Numbers per embedding."""
        return self.config.dimension

    def forward(self, batch: Batch, keep: Tensor | None = None) -> Tensor:
        """Embed; see the base class."""
        return self._pass(batch, trim(batch, self.hops, keep))[0]

    def encode(self, batch: Batch) -> Encoded:
        """Embed, with the attention of the same pass rolled out to the objects (`encoder.paper.credit`).

        Without GATv2, and for a batch whose roots share one graph (a node then has no single root), credit and
        self share are None.
        """
        edges = trim(batch, self.hops)
        embedding, attention = self._pass(batch, edges)
        shared = batch.n_roots > 1 and int(batch.graph[1]) == 0
        if attention is None or shared:
            return Encoded(embedding, None, None)
        return Encoded(embedding, *roll_out(batch, edges, attention))

    def _pass(self, batch: Batch, edges: TrimmedEdges) -> tuple[Tensor, Attention | None]:
        self.check_batch(batch)
        nodes = batch.nodes_within
        x = F.elu(self.project(batch.features[: nodes[self.hops]]))
        for depth, layer in enumerate(self.layers, start=1):
            hops = self.hops - depth
            x = layer(x, *edges.reaching(hops), nodes[hops])
        attention = None
        if self.gat is not None:
            x, attention = self.gat(x, *edges.reaching(0), batch.n_roots)
        z: Tensor = self.embed(x)
        return z / torch.linalg.vector_norm(z, dim=1, keepdim=True).clamp_min(TINY), attention
