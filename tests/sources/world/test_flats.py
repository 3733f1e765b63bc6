"""Flats of one plan: the same rooms and furniture, but each lacks some of it, and has places of its own."""

import numpy as np

from semloc_core.sources.world import KINDS
from semloc_core.sources.world.stacked import draw_flat


def _objects(world) -> set[tuple[str, tuple[float, ...]]]:
    return {(item.class_, tuple(np.round(item.position, 3))) for item in world.graph.objects.values()}


def test_flats_of_one_plan_share_what_they_do_not_lack() -> None:
    whole, _ = draw_flat(KINDS["home"], np.random.default_rng(1), np.random.default_rng(2), lacks=0.0)
    flats = [draw_flat(KINDS["home"], np.random.default_rng(1), np.random.default_rng(s), 0.3)[0] for s in (3, 4)]
    other, _ = draw_flat(KINDS["home"], np.random.default_rng(9), np.random.default_rng(3), 0.3)
    for flat in flats:
        assert _objects(flat) < _objects(whole)
        assert len(_objects(flat)) > 0.4 * len(_objects(whole))
    assert _objects(flats[0]) != _objects(flats[1])
    assert set(flats[0].graph.places.values()) != set(flats[1].graph.places.values())
    assert not _objects(other) & _objects(whole)


def test_the_same_draws_make_the_same_flat() -> None:
    first, again = (draw_flat(KINDS["home"], np.random.default_rng(1), np.random.default_rng(2)) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert (a.graph.objects, a.graph.places) == (b.graph.objects, b.graph.places)
