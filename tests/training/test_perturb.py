import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.resample import place_spacing, resample_places
from semloc_core.training.config import PerturbConfig
from semloc_core.training.views.perturb import add_false_objects, displace_objects, mislabel_objects, perturb

LABELS = Labelspace("t", ("desk", "chair", "plant"), mobility={"chair": 0.5, "desk": 0.0}, default_mobility=0.0)
ALL_AT_ONCE = PerturbConfig(
    jitter_m=0.2, drop_probability=0.2, false_ratio=0.3, mislabel_probability=0.2, resample_probability=1.0
)


def corridor(n: int = 30, n_objects: int = 12, sightings: bool = False) -> GraphArrays:
    """A corridor of places a metre apart and, not joined to it, a room of four; objects along the corridor."""
    xs = np.arange(n, dtype=float)
    places = np.concatenate([np.stack([xs, 0 * xs, 0 * xs], 1), [[5, 9, 0], [6, 9, 0], [6, 10, 0], [5, 10, 0]]]).astype(
        np.float64
    )
    edges = [(i, i + 1) for i in range(n - 1)] + [(n, n + 1), (n + 1, n + 2), (n + 2, n + 3)]
    where = np.linspace(0, n - 1, n_objects).round().astype(int)
    return GraphArrays(
        name="corridor",
        place_ids=tuple(f"p{i:03d}" for i in range(n + 4)),
        place_positions=places,
        place_edges=np.array(edges, dtype=np.int64).T.copy(),
        object_ids=tuple(f"o{i:03d}" for i in range(n_objects)),
        object_positions=places[where] + np.array([0, 0.4, 0]),
        object_classes=(np.arange(n_objects) % 3).astype(np.int64),
        object_parents=np.stack([np.arange(n_objects), where]).astype(np.int64),
        sightings=np.stack([where, np.arange(n_objects)]).astype(np.int64)
        if sightings
        else np.zeros((2, 0), dtype=np.int64),
    )


def arrays_of(graph: GraphArrays) -> list[np.ndarray]:
    return [v for v in vars(graph).values() if isinstance(v, np.ndarray)]


def n_components(graph: GraphArrays) -> int:
    n = graph.n_places
    return connected_components(coo_matrix((np.ones(graph.place_edges.shape[1]), graph.place_edges), (n, n)), False)[0]


def test_same_seed_same_variant():
    one, two = (perturb(corridor(), LABELS, ALL_AT_ONCE, np.random.default_rng(3)) for _ in range(2))
    assert one.object_ids == two.object_ids
    assert one.place_ids == two.place_ids
    assert all(np.array_equal(a, b) for a, b in zip(arrays_of(one), arrays_of(two), strict=True))


def test_defaults_are_the_papers_places_stay_and_objects_move_by_their_mobility():
    graph = corridor(300, 300)
    variant = perturb(graph, LABELS, PerturbConfig(), np.random.default_rng(0))
    assert variant.place_ids == graph.place_ids
    assert np.array_equal(variant.place_edges, graph.place_edges)
    offset = variant.object_positions - graph.object_positions
    assert np.all(offset[graph.object_classes != 1] == 0)
    assert offset[graph.object_classes == 1, :2].std() == pytest.approx(0.5, rel=0.15)
    assert np.all(offset[:, 2] == 0)


def test_the_original_is_left_alone():
    graph, untouched = corridor(), corridor()
    perturb(graph, LABELS, ALL_AT_ONCE, np.random.default_rng(0))
    assert all(np.array_equal(a, b) for a, b in zip(arrays_of(graph), arrays_of(untouched), strict=True))


def test_moved_objects_go_to_the_nearest_place():
    graph = corridor()
    moved = displace_objects(graph, np.full(graph.n_objects, 3.0), np.random.default_rng(1))
    distance = np.linalg.norm(moved.object_positions[:, None] - moved.place_positions[None], axis=-1)
    assert np.array_equal(moved.object_parents[0], np.arange(graph.n_objects))
    assert np.array_equal(moved.object_parents[1], distance.argmin(1))


def test_an_object_without_a_parent_gets_none():
    graph = corridor()
    orphaned = GraphArrays(**{**vars(graph), "object_parents": graph.object_parents[:, 1:]})
    moved = displace_objects(orphaned, np.full(graph.n_objects, 1.0), np.random.default_rng(1))
    assert 0 not in moved.object_parents[0]


def test_sightings_move_with_the_object():
    """An object seen from its own place only, shifted by one place, is seen from the next place only."""
    graph = corridor(sightings=True)

    class OneMetreEast:
        def normal(self, size: tuple[int, int]) -> np.ndarray:
            return np.tile([1.0, 0.0], (size[0], 1))

    moved = displace_objects(graph, np.ones(graph.n_objects), OneMetreEast())
    seen = {int(o): int(p) for p, o in moved.sightings.T if p < 30}
    for p, o in graph.sightings.T[:-1]:
        assert seen[int(o)] == int(p) + 1


def test_drop_probability_one_leaves_no_objects():
    variant = perturb(corridor(), LABELS, PerturbConfig(drop_probability=1.0), np.random.default_rng(0))
    assert variant.n_objects == 0
    assert variant.object_parents.shape == (2, 0)


def test_mislabelled_objects_get_another_class():
    graph = corridor(200, 200)
    wrong = np.arange(200) % 2 == 0
    variant = mislabel_objects(graph, 3, wrong, np.random.default_rng(0))
    assert np.all((variant.object_classes != graph.object_classes) == wrong)


def test_a_labelspace_of_one_class_cannot_be_mislabelled():
    graph = corridor()
    graph = GraphArrays(**{**vars(graph), "object_classes": np.zeros(graph.n_objects, dtype=np.int64)})
    variant = mislabel_objects(graph, 1, np.ones(graph.n_objects, dtype=bool), np.random.default_rng(0))
    assert np.all(variant.object_classes == 0)


def test_unknown_classes_survive_every_perturbation():
    graph = corridor()
    graph = GraphArrays(**{**vars(graph), "object_classes": np.full(graph.n_objects, -1)})
    variant = perturb(graph, LABELS, ALL_AT_ONCE, np.random.default_rng(0))
    assert set(variant.object_classes.tolist()) <= {-1, 0, 1, 2}


def test_false_objects_follow_the_class_frequencies_and_stand_near_places():
    graph = corridor()
    graph = GraphArrays(**{**vars(graph), "object_classes": np.array([0] * 9 + [2] * 3, dtype=np.int64)})
    variant = add_false_objects(graph, 1000, np.random.default_rng(0))
    assert variant.n_objects == graph.n_objects + 1000
    assert list(variant.object_ids) == sorted(variant.object_ids)
    assert np.mean(variant.object_classes == 0) == pytest.approx(0.75, abs=0.05)
    assert not np.any(variant.object_classes == 1)
    parent = variant.place_positions[variant.object_parents[1]]
    assert np.linalg.norm(parent - variant.object_positions[variant.object_parents[0]], axis=1).max() < 6
    # Real objects keep class and parent under their new index.
    for old, name in enumerate(graph.object_ids):
        new = variant.object_ids.index(name)
        assert variant.object_classes[new] == graph.object_classes[old]
        assert variant.object_parents[1, variant.object_parents[0] == new] == graph.object_parents[1, old]


@pytest.mark.parametrize("spacing", [0.7, 1.0, 1.5])
def test_places_sampled_anew_keep_what_was_connected(spacing):
    graph = corridor()
    laid = resample_places(graph, spacing, np.random.default_rng(5))
    assert n_components(laid) == n_components(graph) == 2
    assert not set(laid.place_ids) & set(graph.place_ids)
    assert list(laid.place_ids) == sorted(laid.place_ids)
    assert np.all(laid.place_edges[0] < laid.place_edges[1])
    assert laid.edge_lengths().max() < 3 * spacing


def test_places_sampled_anew_stay_in_free_space_and_are_new():
    graph = corridor()
    laid = resample_places(graph, 1.0, np.random.default_rng(5))
    east = laid.place_positions[laid.place_positions[:, 1] < 5]
    assert np.abs(east[:, 1]).max() < 1.0
    distance = np.linalg.norm(laid.place_positions[:, None] - graph.place_positions[None], axis=-1).min(1)
    assert np.median(distance) > 0.05
    assert 0.5 * graph.n_places < laid.n_places < 1.5 * graph.n_places


def test_places_sampled_anew_take_objects_and_sightings_along():
    laid = resample_places(corridor(sightings=True), 1.0, np.random.default_rng(2))
    assert np.array_equal(np.unique(laid.object_parents[0]), np.arange(12))
    places, objects = laid.sightings
    assert np.linalg.norm(laid.place_positions[places] - laid.object_positions[objects], axis=1).max() < 1.0


def test_places_without_edges_are_kept():
    graph = corridor()
    graph = GraphArrays(**{**vars(graph), "place_edges": np.zeros((2, 0), dtype=np.int64)})
    laid = resample_places(graph, 0.5, np.random.default_rng(0))
    assert laid.n_places == graph.n_places
    assert laid.place_edges.shape == (2, 0)


@pytest.mark.parametrize("n_places", [0, 1])
def test_a_building_of_no_or_one_place_is_perturbed_without_error(n_places):
    graph = GraphArrays(
        name="tiny",
        place_ids=("p",)[:n_places],
        place_positions=np.zeros((n_places, 3)),
        place_edges=np.zeros((2, 0), dtype=np.int64),
        object_ids=("o",),
        object_positions=np.ones((1, 3)),
        object_classes=np.zeros(1, dtype=np.int64),
        object_parents=np.zeros((2, n_places), dtype=np.int64),
        sightings=np.zeros((2, 0), dtype=np.int64),
    )
    variant = perturb(graph, LABELS, ALL_AT_ONCE, np.random.default_rng(0))
    assert variant.n_places == n_places
    assert place_spacing(variant) == 0.0


def test_edges_that_are_not_found_are_dropped_and_nothing_else():
    graph = corridor()
    still = PerturbConfig(mobility_scale=0.0, edge_drop_probability=0.5)
    found = perturb(graph, LABELS, still, np.random.default_rng(0))
    kept = {tuple(edge) for edge in found.place_edges.T.tolist()}
    assert kept < {tuple(edge) for edge in graph.place_edges.T.tolist()}
    assert 8 < len(kept) < 24
    assert found.place_ids == graph.place_ids
    assert (found.object_parents == graph.object_parents).all()
