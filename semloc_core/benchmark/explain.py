"""Explainers beside their peers, PyG and Captum: one graph, the same weights, one thread, one run.

PyG's ``CaptumExplainer`` and Captum are what one would use without this library. Both take the network as PyG's own
layers make it, with the weights of the encoder; before anything is timed, all must agree on the similarity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from semloc_core.benchmark.timing import Contender, by_turns
from semloc_core.encoding import Batch, PaperEncoder, PlaceBatches
from semloc_core.errors import ConfigError
from semloc_core.explain import SimilarityQuery, class_shapley, integrated_gradients
from semloc_core.graph import GraphArrays, Labelspace
from semloc_core.metrics import Progress, Row, no_progress
from semloc_core.text import short_repr

PLACES, COLUMNS, PITCH_M = 30, 6, 1.2
OBJECTS, CLASSES = 30, 6
STEPS, SAMPLES = 50, 25
"""Points of Integrated Gradients and orders of Shapley sampling: Captum's and PyG's defaults."""


class Peer(nn.Module):
    """The paper's encoder out of PyG's layers, with an encoder's weights: similarity of a graph's root to a target."""

    def __init__(self, encoder: PaperEncoder, target: Tensor) -> None:
        from torch_geometric.nn import GATv2Conv, GraphConv  # type: ignore[import-untyped]

        super().__init__()
        config, ours = encoder.config, encoder.gat
        if ours is None:
            raise ConfigError("expected an encoder with a GAT block (got one without)")
        hidden = config.hidden
        self.target = target
        self.project, self.embed = encoder.project, encoder.embed
        convs = [GraphConv(hidden, hidden) for _ in range(config.layers)]
        self.norms = nn.ModuleList(layer.get_submodule("norm") for layer in encoder.layers)
        self.gat = GATv2Conv(hidden, hidden, config.heads, add_self_loops=config.self_loops)
        with torch.no_grad():
            for conv, layer in zip(convs, encoder.layers, strict=True):
                conv.lin_rel.load_state_dict(layer.get_submodule("message").state_dict())
                conv.lin_root.load_state_dict(layer.get_submodule("root").state_dict())
            self.convs = nn.ModuleList(convs)
            self.gat.lin_l.load_state_dict(ours.source.state_dict())
            self.gat.lin_r.load_state_dict(ours.target.state_dict())
            self.gat.att.copy_(ours.attention[None])
            self.gat.bias.copy_(ours.bias)
        self.eval()

    def embeddings(self, x: Tensor, edge_index: Tensor, n_roots: int) -> Tensor:
        """(N, C) features -> (B, D) embeddings of the roots, which come first; every node at every layer."""
        x = F.elu(self.project(x))
        for conv, norm in zip(self.convs, self.norms, strict=True):
            x = norm(torch.tanh(conv(x, edge_index)))
        return F.normalize(self.embed(self.gat(x, edge_index)[:n_roots]), dim=1)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        """(N, C) features -> (1,) similarity."""
        return self.embeddings(x, edge_index, 1) @ self.target


@short_repr
@dataclass(frozen=True, eq=False)
class Case:
    """One query to explain, for this library and for its peers."""

    query: SimilarityQuery
    batch: Batch
    encoder: PaperEncoder
    peer: Peer


def make_case(seed: int = 0) -> Case:
    """A hall of 30 places, 1.2 m apart, with 30 objects of 6 classes, seen from its middle; random weights."""
    rng = np.random.default_rng(seed)
    space = Labelspace("bench", tuple(f"class {i}" for i in range(CLASSES)))
    column, row = np.meshgrid(np.arange(COLUMNS), np.arange(PLACES // COLUMNS), indexing="ij")
    at = PITCH_M * np.stack([column.ravel(), row.ravel(), np.zeros(PLACES)], axis=1)
    near = np.argwhere(np.triu(np.linalg.norm(at[:, None] - at[None], axis=2) < 1.1 * PITCH_M, k=1)).T
    positions = rng.uniform(at.min(0), at.max(0), (OBJECTS, 3))
    parents = np.linalg.norm(positions[:, None] - at[None], axis=2).argmin(1)
    arrays = GraphArrays(
        name="hall",
        place_ids=tuple(f"p{i:02d}" for i in range(PLACES)),
        place_positions=at.astype(np.float64),
        place_edges=near,
        object_ids=tuple(f"o{i:02d}" for i in range(OBJECTS)),
        object_positions=positions,
        object_classes=np.arange(OBJECTS) % CLASSES,
        object_parents=np.stack([np.arange(OBJECTS), parents]),
        sightings=np.zeros((2, 0), dtype=np.int64),
    )
    encoder = PaperEncoder(None, CLASSES, torch.Generator().manual_seed(seed)).eval()
    middle = int(np.linalg.norm(at - at.mean(0), axis=1).argmin())
    batch = PlaceBatches(arrays, CLASSES, encoder.extraction).of(middle)
    names = [space.classes[c] for c in batch.features.argmax(1).tolist()]
    target = F.normalize(torch.randn(encoder.dimension, generator=torch.Generator().manual_seed(seed + 1)), dim=0)
    return Case(SimilarityQuery.from_encoder(encoder, batch, target, names), batch, encoder, Peer(encoder, target))


def bench_explain(
    repeats: int = 20, *, slow: bool = True, seed: int = 0, progress: Progress = no_progress
) -> list[Row]:
    """Time explainers and their peers on one thread.

    Args:
        repeats: how often each is timed; PyG's Shapley sampling, which takes seconds, a tenth as often.
        slow: whether PyG's Shapley sampling runs at all.
        seed: of the graph and the weights.
        progress: told of every repeat.

    Returns:
        A row a task and contender, as of `semloc_core.benchmark.timing.timed_row`.

    Raises:
        ConfigError: the peers do not compute the same similarity.

    """
    with one_thread():
        case = make_case(seed)
        return _timed(case, repeats, slow, progress)


def _timed(case: Case, repeats: int, slow: bool, progress: Progress) -> list[Row]:
    from captum.attr import ShapleyValueSampling  # type: ignore[import-untyped]

    query, peer, x, edges = case.query, case.peer, case.batch.features, case.batch.edge_index
    with torch.no_grad():
        theirs = float(peer(x, edges))
    if abs(theirs - query.full) > 1e-5:
        raise ConfigError(f"expected peers that agree with {query.full:.6f} (got {theirs:.6f})")
    players = torch.zeros((1, *x.shape), dtype=torch.int64)  # places, without features, go with the first player
    players[0, query.rows] = torch.from_numpy(query.class_players[1])[:, None]
    captum = ShapleyValueSampling(lambda features: peer(features[0], edges))
    pyg_gradients, pyg_shapley = _pyg(peer, "IntegratedGradients"), _pyg(peer, "ShapleyValueSampling")
    rng = np.random.default_rng(0)
    gradients = f"integrated gradients, {STEPS} steps"
    shapley = f"Shapley values of {len(query.class_players[0])} classes"

    def captum_classes() -> object:
        with torch.no_grad():
            return captum.attribute(x[None], feature_mask=players, n_samples=SAMPLES)

    contenders = [
        Contender(gradients, "semloc", lambda: integrated_gradients(query, steps=STEPS)),
        Contender(gradients, "pyg", lambda: pyg_gradients(x, edges)),
        Contender(shapley, "semloc, exact", lambda: class_shapley(query, rng)),
        Contender(shapley, f"captum, {SAMPLES} samples", captum_classes),
    ]
    if slow:
        contenders.append(Contender(shapley, "pyg at its defaults", lambda: pyg_shapley(x, edges), seldom=True))
    return by_turns(contenders, repeats, progress)


def _pyg(peer: Peer, method: str) -> Callable[[Tensor, Tensor], object]:
    """PyG's explainer of node features, with its defaults."""
    from torch_geometric.explain import CaptumExplainer, Explainer  # type: ignore[import-untyped]

    return Explainer(  # type: ignore[no-any-return]  # PyG has no types
        peer,
        algorithm=CaptumExplainer(method),
        explanation_type="model",
        node_mask_type="attributes",
        edge_mask_type=None,
        model_config={"mode": "regression", "task_level": "graph", "return_type": "raw"},
    )


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch on one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
