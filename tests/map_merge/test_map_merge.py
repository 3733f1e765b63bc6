"""Merging a later traversal: where it lies, what it confirms, moves, misses and adds; and when it is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from lived_in import AGAIN, ELSEWHERE, ONE_LINE, inverse, moved, office, rings, seen_again

from semloc_core.encoding.encoder import build_encoder
from semloc_core.encoding.model import Model, embed_graph
from semloc_core.errors import MapError
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.map_database.history import ClassChange, History, ObjectBelief
from semloc_core.map_database.weights import class_weights, object_weights
from semloc_core.map_merge import MergeConfig, merge
from semloc_core.map_merge.edit import without_places
from semloc_core.map_merge.merging import Merged
from semloc_core.map_merge.persistence import Observation, judge
from semloc_core.map_merge.store import side
from semloc_core.map_merge.transform import Transform, fit_transform
from semloc_core.training.views.perturb import perturb


def merged(graph: SceneGraph, traversal: SceneGraph, history: History | None = None) -> Merged:
    _, space = office()
    model, plain = rings(space), dict.fromkeys(space.classes, 1.0)
    return merge(side(model, graph, plain), history or History(), side(model, traversal, plain))


def test_a_transform_is_found_from_points_and_weights():
    rng = np.random.default_rng(0)
    points = rng.normal(0.0, 5.0, (12, 3))
    target = ELSEWHERE.apply(points)
    target[0] += 50.0
    weights = np.ones(12)
    weights[0] = 0.0
    found = fit_transform(points, target, weights)
    assert math.isclose(found.yaw, ELSEWHERE.yaw, abs_tol=1e-9)
    np.testing.assert_allclose(found.translation, ELSEWHERE.translation, atol=1e-9)
    np.testing.assert_allclose(inverse(found).apply(found.apply(points)), points, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_traversal_of_another_frame_is_laid_where_it_belongs(seed):
    """Else all that follows would be written to the wrong spots."""
    arrays, space = office(seed)
    result = merged(arrays.to_scene_graph(space), seen_again(arrays, space, seed))
    points = arrays.place_positions
    away = result.alignment.transform.apply(ELSEWHERE.apply(points)) - points
    assert np.linalg.norm(away, axis=1).max() < 0.3
    assert result.traversal.confirmed > 0.6 * arrays.n_objects
    assert result.traversal.residual_m < 0.4


@pytest.mark.parametrize("seed", range(3))
def test_a_traversal_of_another_building_is_refused(seed):
    arrays, space = office(seed)
    other, _ = office(seed + 1)
    with pytest.raises(MapError, match=ONE_LINE):
        merged(arrays.to_scene_graph(space), seen_again(other, space))


def test_a_mirror_image_is_refused():
    """The same objects at the same distances, but no turn and shift lays them there."""
    arrays, space = office()
    mirror = np.array([-1.0, 1.0, 1.0])
    image = replace(
        arrays, place_positions=arrays.place_positions * mirror, object_positions=arrays.object_positions * mirror
    )
    with pytest.raises(MapError, match=r"as by chance|objects"):
        merged(arrays.to_scene_graph(space), image.to_scene_graph(space))


def test_what_has_too_little_to_go_by_is_refused():
    arrays, space = office()
    graph = arrays.to_scene_graph(space)
    none = arrays.with_objects(np.zeros(arrays.n_objects, dtype=np.bool_)).to_scene_graph(space)
    few = arrays.with_objects(np.arange(arrays.n_objects) < 3).to_scene_graph(space)
    for traversal in (none, few, SceneGraph()):
        with pytest.raises(MapError, match=ONE_LINE):
            merged(graph, traversal)


def test_a_building_in_which_it_fits_two_ways_is_refused():
    """Two wings that look the same: a robot in one of them must not be written into the other."""
    arrays, space = office()
    wing = moved(arrays, Transform(0.0, (200.0, 0.0, 0.0)))
    p, o = arrays.n_places, arrays.n_objects
    both = replace(
        arrays,
        place_ids=(*arrays.place_ids, *(f"z{i}" for i in arrays.place_ids)),
        place_positions=np.concatenate([arrays.place_positions, wing.place_positions]),
        place_edges=np.concatenate([arrays.place_edges, arrays.place_edges + p], axis=1),
        object_ids=(*arrays.object_ids, *(f"z{i}" for i in arrays.object_ids)),
        object_positions=np.concatenate([arrays.object_positions, wing.object_positions]),
        object_classes=np.concatenate([arrays.object_classes] * 2),
        object_parents=np.concatenate([arrays.object_parents, arrays.object_parents + np.array([[o], [p]])], axis=1),
    )
    with pytest.raises(MapError, match="one way to lay"):
        merged(both.to_scene_graph(space), seen_again(arrays, space))


def test_the_same_traversal_again_changes_no_place_and_takes_no_weight():
    arrays, space = office()
    graph = arrays.to_scene_graph(space)
    result = merged(graph, moved(arrays, ELSEWHERE).to_scene_graph(space))
    counts = result.traversal
    assert (counts.moved, counts.missing, counts.added, counts.forgotten, counts.places) == (0, 0, 0, 0, 0)
    assert counts.confirmed == arrays.n_objects
    assert result.graph.neighbours.keys() == graph.neighbours.keys()
    assert result.graph.objects.keys() == graph.objects.keys()
    assert all(belief.persistence > ObjectBelief().persistence for belief in result.history.objects.values())
    model = rings(space)
    weights = object_weights(result.graph, space, result.history, class_weights([result.history.classes], space))
    before, after = (
        embed_graph(model, arrays),
        embed_graph(model, GraphArrays.from_scene_graph(result.graph, space), weights),
    )
    assert (before * after).sum(axis=1).min() > 0.999


def test_merges_repeated_converge():
    """What every traversal sees is believed in ever more; what none sees is forgotten, and the map stops growing."""
    arrays, space = office()
    first = perturb(arrays, space, AGAIN, np.random.default_rng(50))
    graph, history = first.to_scene_graph(space), History()
    sizes = []
    for seed in range(5):
        result = merged(graph, seen_again(arrays, space, seed), history)
        graph, history = result.graph, result.history
        sizes.append(len(graph.objects))
    assert [each.source for each in history.traversals] == [""] * 5
    assert abs(sizes[-1] - sizes[-2]) < 0.1 * arrays.n_objects
    belief = {key: history.objects[key].persistence for key in graph.objects}
    places = np.array([graph.objects[key].position for key in belief])
    off = np.linalg.norm(places[:, None] - arrays.object_positions, axis=2).min(axis=1)
    real, invented = np.array(list(belief.values()))[off < 0.5], np.array(list(belief.values()))[off > 1.5]
    assert real.mean() > 0.85
    assert not len(invented) or invented.mean() < 0.55
    assert np.count_nonzero(off < 0.5) > 0.97 * arrays.n_objects, "what one traversal missed another has added"


def test_an_object_that_moved_is_put_where_it_is_now():
    arrays, space = office()
    which = int(np.flatnonzero(arrays.object_classes == space.index("couch"))[0])
    alone = arrays.with_objects(
        (arrays.object_classes != space.index("couch")) | (np.arange(arrays.n_objects) == which)
    )
    place = int(alone.object_parents[1][alone.object_parents[0] == alone.object_ids.index(arrays.object_ids[which])][0])
    i = alone.object_ids.index(arrays.object_ids[which])
    away = np.linalg.norm(alone.place_positions - alone.place_positions[place], axis=1)
    target = int(np.argmin(np.abs(away - 3.0)))
    positions, parents = alone.object_positions.copy(), alone.object_parents.copy()
    positions[i, :2] = alone.place_positions[target, :2]
    parents[1, parents[0] == i] = target
    later = moved(replace(alone, object_positions=positions, object_parents=parents), ELSEWHERE)
    result = merged(alone.to_scene_graph(space), later.to_scene_graph(space))
    assert result.traversal.moved == 1
    couch = result.graph.objects[alone.object_ids[i]]
    np.testing.assert_allclose(couch.position, positions[i], atol=0.1)
    assert result.history.objects.get(couch.id, ObjectBelief()).seen == 1, "what is believed of it begins anew"
    rates = {name: 1 - weight for name, weight in class_weights([result.history.classes], space).items()}
    assert rates["couch"] == max(rates.values())


def test_new_places_come_with_edges_and_what_is_there():
    """A map of a part of the building grows by what is seen of the rest, and stays in one piece."""
    arrays, space = office()
    west = arrays.place_positions[:, 0] < np.quantile(arrays.place_positions[:, 0], 0.7)
    graph = arrays.to_scene_graph(space)
    part = without_places(graph, [p for p, kept in zip(arrays.place_ids, west, strict=True) if not kept])
    result = merged(part, moved(arrays, ELSEWHERE).to_scene_graph(space))
    added = result.graph.places.keys() - part.places.keys()
    assert len(added) == result.traversal.places > 0.8 * np.count_nonzero(~west)
    new = GraphArrays.from_scene_graph(result.graph, space)
    lengths = new.edge_lengths()
    assert lengths.max() < 1.5 * arrays.edge_lengths().max()
    reached, frontier = {new.place_ids[0]}, [new.place_ids[0]]
    while frontier:
        frontier = [b for a in frontier for b in result.graph.neighbours[a] if b not in reached and not reached.add(b)]
    assert reached == set(new.place_ids)
    assert len(result.graph.objects) == arrays.n_objects
    assert all(result.graph.parents[key] for key in result.graph.objects)


def test_a_part_of_the_building_says_nothing_of_the_rest():
    arrays, space = office()
    graph = arrays.to_scene_graph(space)
    east = [p for p, x in zip(arrays.place_ids, arrays.place_positions[:, 0], strict=True) if x > 25.0]
    seen = without_places(graph, east)
    later = GraphArrays.from_scene_graph(seen, space)
    result = merged(graph, moved(later, ELSEWHERE).to_scene_graph(space))
    assert result.traversal.missing == 0
    assert len(result.graph.objects) == arrays.n_objects
    unseen = set(graph.objects) - set(seen.objects)
    assert unseen
    assert not unseen & result.history.objects.keys(), "nothing is believed of what was out of sight"


def observed(**changes: object) -> Observation:
    """Forty paintings that were all found, and ten chairs of which some were."""
    n = 50
    values: dict[str, object] = {
        "classes": ["painting"] * 40 + ["chair"] * 10,
        "beliefs": [ObjectBelief()] * n,
        "confirmed": np.arange(n) < 42,
        "expected": np.ones(n, dtype=np.bool_),
        "positions": np.stack([np.arange(n) * 20.0, np.zeros(n), np.zeros(n)], axis=1),
        "spare": np.zeros((0, 3)),
        "spare_classes": [],
        "area": 1000.0,
    }
    return Observation(**{**values, **changes})


def test_a_miss_takes_more_from_a_class_that_moves():
    earlier = [{"chair": ClassChange(20, 80), "painting": ClassChange(100, 0)}]
    missing = np.arange(50) != 0
    missing[45:] = False
    verdict = judge(observed(confirmed=missing), earlier, MergeConfig(), 0.5)
    painting, chair = verdict.persistence[0], verdict.persistence[49]
    assert chair < 0.6 * painting < painting < ObjectBelief().persistence
    assert verdict.persistence[1] > ObjectBelief().persistence, "what is confirmed gains"


def test_mobility_is_learnt_from_what_goes_missing():
    verdict = judge(observed(), [], MergeConfig(), 0.5)
    chair, painting = verdict.changes["chair"], verdict.changes["painting"]
    assert chair.moved / (chair.moved + chair.stayed) > 5 * painting.moved / (painting.moved + painting.stayed)
    assert class_weights([verdict.changes], office()[1])["chair"] < 0.9


def test_what_was_out_of_sight_is_believed_as_before():
    expected = np.arange(50) < 45
    verdict = judge(observed(expected=expected), [], MergeConfig(), 0.5)
    np.testing.assert_array_equal(verdict.persistence[45:], ObjectBelief().persistence)
    assert verdict.changes["chair"].stayed + verdict.changes["chair"].moved <= 5


def test_a_stranger_beside_a_gap_is_the_object_that_left_it():
    positions = observed().positions
    verdict = judge(
        observed(spare=positions[[49]] + [[2.0, 0.0, 0.0]], spare_classes=["chair"]),
        [{"chair": ClassChange(50, 50)}],
        MergeConfig(),
        0.5,
    )
    assert verdict.moved_to[49] == 0
    assert (verdict.moved_to[:49] == -1).all()


def test_misses_of_one_detector_are_not_independent():
    """What it never saw may be hard to see; what it used to see is gone sooner."""
    never, always = ObjectBelief(0.8, 1, 4), ObjectBelief(0.8, 4, 4)
    beliefs = [always] * 49 + [never]
    verdict = judge(observed(beliefs=beliefs), [], MergeConfig(), 0.5)
    assert verdict.persistence[49] > 1.5 * verdict.persistence[48]


def test_weights_are_what_persists_times_what_stays():
    arrays, space = office()
    graph = arrays.to_scene_graph(space)
    key = next(k for k in sorted(graph.objects) if graph.objects[k].class_ == "chair")
    plain = class_weights([], space)
    assert set(plain.values()) == {1.0}
    assert set(object_weights(graph, space, History(), plain).values()) == {1.0}
    counts = {"chair": ClassChange(50, 50)}
    of_class = class_weights([counts], space)
    history = History(traversals=(), objects={key: ObjectBelief(0.25, 1, 2)}, classes=counts)
    assert object_weights(graph, space, history, of_class)[key] == pytest.approx(0.25 * of_class["chair"])


@pytest.mark.parametrize("encoder", ["rings", "bag_of_words", "histogram"])
def test_an_object_of_weight_two_counts_as_two(encoder):
    """For encoders that count; a weight of nought is as if it were not there."""
    arrays, space = office()
    model = Model(build_encoder(encoder, None, len(space)), space)
    n = arrays.n_objects
    links = arrays.object_parents[:, arrays.object_parents[0] == 0]
    twice = replace(
        arrays,
        object_ids=(*arrays.object_ids, "~copy"),
        object_positions=np.concatenate([arrays.object_positions, arrays.object_positions[:1]]),
        object_classes=np.append(arrays.object_classes, arrays.object_classes[0]),
        object_parents=np.concatenate([arrays.object_parents, links + np.array([[n], [0]])], axis=1),
    )
    key = arrays.object_ids[0]
    np.testing.assert_allclose(embed_graph(model, arrays, {key: 2.0}), embed_graph(model, twice), atol=1e-6)
    without = arrays.with_objects(np.arange(n) > 0)
    np.testing.assert_allclose(embed_graph(model, arrays, {key: 0.0}), embed_graph(model, without), atol=1e-6)


def test_the_papers_encoder_leaves_weights_out():
    """It does not count: scaled features would only blur what a node is."""
    arrays, space = office()
    model = Model(build_encoder("paper", {"hidden": 8, "heads": 1}, len(space)), space)
    np.testing.assert_array_equal(
        embed_graph(model, arrays, dict.fromkeys(arrays.object_ids, 0.3)), embed_graph(model, arrays)
    )
