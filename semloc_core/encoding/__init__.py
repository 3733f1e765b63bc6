"""From a place and what is around it to an embedding: extraction, encoders, and the model that keeps one."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.encoding.encoder import build_encoder
    from semloc_core.encoding.encoder.bag_of_words import BagOfWordsEncoder, HistogramEncoder, TfidfEncoder
    from semloc_core.encoding.encoder.base import Encoded, Encoder
    from semloc_core.encoding.encoder.discriminant import Pairs
    from semloc_core.encoding.encoder.paper.encoder import PaperConfig, PaperEncoder
    from semloc_core.encoding.encoder.query import FEW, QueryEncoder
    from semloc_core.encoding.general import LEAST_KNOWN, load_general, load_model, pick_general
    from semloc_core.encoding.live_graph import LiveGraph, Query
    from semloc_core.encoding.model import Model, embed_batch, embed_graph, embed_places
    from semloc_core.encoding.place_graph import extract, extract_all
    from semloc_core.encoding.place_graph.batch import Batch, batch_of_arrays
    from semloc_core.encoding.place_graph.combine import repeat, union
    from semloc_core.encoding.place_graph.cut import PlaceBatches
    from semloc_core.encoding.place_graph.extraction import Extraction
    from semloc_core.encoding.place_graph.free_space import Bands, free_space, place_cells
    from semloc_core.encoding.place_graph.reach import reach_all_batch, take_stars
    from semloc_core.encoding.similarity import similarity_matrix
    from semloc_core.encoding.surroundings import Surroundings
    from semloc_core.encoding.variants.perturbed import NODES_AT_ONCE, PerturbedEncoder, normal, products
else:
    __getattr__ = exports(__name__)

__all__ = [
    "BagOfWordsEncoder", "Bands", "Batch", "Encoded", "Encoder", "Extraction", "FEW", "HistogramEncoder",
    "LEAST_KNOWN", "LiveGraph", "Model", "NODES_AT_ONCE", "Pairs", "PaperConfig", "PaperEncoder", "PerturbedEncoder",
    "PlaceBatches", "Query", "QueryEncoder", "Surroundings", "TfidfEncoder", "batch_of_arrays", "build_encoder",
    "embed_batch", "embed_graph", "embed_places", "extract", "extract_all", "free_space", "load_general",
    "load_model", "normal", "pick_general", "place_cells", "products", "reach_all_batch", "repeat",
    "similarity_matrix", "take_stars", "union",
]  # fmt: skip
