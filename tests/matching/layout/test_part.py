"""Buildings read one by one and joined make the same verifier as reading them together, to the last bit."""

import numpy as np

from semloc_core.matching.layout import LayoutConfig, LayoutPart, LayoutVerifier, fragment_of_arrays


def same(a, b):
    np.testing.assert_array_equal(a, b)
    assert a.dtype == b.dtype


def test_a_joined_verifier_is_the_one_made_of_all_buildings(homes):
    maps, again, space = homes
    rng = np.random.default_rng(0)
    rows = [np.sort(rng.permutation(home.n_places)[: home.n_places - 3]) for home in maps]
    weights = [rng.uniform(0.3, 1.0, home.n_objects) for home in maps]
    whole = LayoutVerifier(maps, rows, len(space), weights=weights)
    parts = [LayoutPart.of(home, r, len(space), w) for home, r, w in zip(maps, rows, weights, strict=True)]
    joined = LayoutVerifier.joined(parts)
    for name in ("positions", "building", "object_positions", "object_classes", "detected", "invented"):
        same(getattr(joined.mapped, name), getattr(whole.mapped, name))
    for name in ("start", "objects", "classes", "metres", "bearing", "up"):
        same(getattr(joined.mapped.around, name), getattr(whole.mapped.around, name))
    for place in range(0, again[1].n_places, 5):
        fragment = fragment_of_arrays(again[1], place, whole.config)
        same(joined._scan.log_likelihood(fragment), whole._scan.log_likelihood(fragment))
        mine, theirs = joined.verify(fragment), whole.verify(fragment)
        for name in ("rows", "score", "heading", "shift", "explained", "missing", "walls"):
            same(getattr(mine, name), getattr(theirs, name))


def test_parts_are_read_once_however_they_are_joined(homes, monkeypatch):
    maps, _, space = homes
    parts = [LayoutPart.of(home, np.arange(home.n_places), len(space)) for home in maps]
    for name in ("Nearby", "RingCounter", "room_of"):
        monkeypatch.setattr(f"semloc_core.matching.layout.building.layout.{name}", None)
    swapped = LayoutVerifier.joined(parts[::-1])
    assert swapped._scan is not None
    assert np.bincount(swapped.mapped.building).tolist() == [maps[1].n_places, maps[0].n_places]


def test_no_buildings_are_no_answer(homes):
    fragment = fragment_of_arrays(homes[1][0], 0, LayoutConfig())
    assert LayoutVerifier([], [], len(homes[2])).verify(fragment) is None
