"""The compiled test gives what the plain one does: whether an engineer installs numba changes no answer."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_core.evaluate.verified_answers import any_frame, layout_verifier, written_in
from semloc_core.graph.arrays import GraphArrays
from semloc_core.matching.layout import fragment_of_arrays
from semloc_core.matching.layout.compiled import OFF, compiled
from semloc_core.matching.layout.confidence import confidence
from semloc_core.matching.layout.pose.placed import placed
from semloc_core.sources.world import KINDS, draw_pair
from semloc_core.sources.world.stacked import draw_stacked

numba = pytest.importorskip("numba", reason="numba is not installed: nothing is compiled")

DRIFT = 0.3


@pytest.fixture
def both(monkeypatch):
    """What a piece of work gives without anything compiled, and with it."""

    def run(work):
        found = []
        for off in ("1", ""):
            monkeypatch.setenv(OFF, off)
            compiled.cache_clear()
            assert compiled() is not bool(off)
            found.append(work())
        return found

    yield run
    monkeypatch.undo()
    compiled.cache_clear()


@pytest.fixture(scope="module")
def town():
    """Homes, one of two storeys, as mapped and as seen again in another frame; and fragments of the latter."""
    rng = np.random.default_rng(8)
    pairs = [draw_pair(KINDS["home"], rng) for _ in range(2)]
    pairs.append(draw_stacked(KINDS["home"], 2, rng, alike=False))
    space = pairs[0][0].labelspace
    maps, again = (
        tuple(GraphArrays.from_scene_graph(pair[i].graph, space, str(n)) for n, pair in enumerate(pairs))
        for i in (0, 1)
    )
    config = layout_verifier(maps, len(space)).config
    fragments = []
    for graph in again:
        seen = written_in(any_frame(rng), graph)
        for i, place in enumerate(range(5, graph.n_places, graph.n_places // 6)):
            ages = rng.uniform(0.0, 20.0, graph.n_objects)
            one = fragment_of_arrays(seen, place, config, ages, DRIFT if i % 2 else None)
            if i % 3 == 2:  # a detector that gives several names
                likely = np.full((len(one.classes), len(space) + 1), 0.0)
                likely[np.arange(len(one.classes)), one.classes] = 0.7
                likely[np.arange(len(one.classes)), (one.classes + 1) % len(space)] = 0.2
                likely[:, -1] = 0.1
                one = replace(one, likely=likely)
            fragments.append(one)
    return maps, len(space), fragments


def test_every_answer_is_the_same_compiled_or_not(both, town):
    """Places, scores, chances, poses and covariances, of objects of one name and of several, on one storey and two."""
    maps, n_classes, fragments = town

    def answers():
        verifier = layout_verifier(maps, n_classes)
        for i, fragment in enumerate(fragments):
            tested = verifier.verify(fragment, only=None if i % 4 else verifier.mapped.building != i % 3)
            sure = confidence(tested, fragment, verifier.mapped)
            yield tested, sure, placed(verifier.mapped, fragment, tested, tested.rows[:3].tolist())

    plainly, compiled_ = both(lambda: list(answers()))
    assert len(plainly) > 15
    for (plain, said, where), (quick, also, there) in zip(plainly, compiled_, strict=True):
        assert plain.rows.tolist() == quick.rows.tolist()
        np.testing.assert_allclose(plain.score, quick.score, atol=2e-6)
        for name in ("shift", "rise", "explained", "missing", "walls"):
            np.testing.assert_allclose(getattr(plain, name), getattr(quick, name), atol=1e-6, err_msg=name)
        assert said.answers.storey.tolist() == also.answers.storey.tolist()
        np.testing.assert_allclose(said.probability, also.probability, atol=1e-6)
        assert set(where) == set(there)
        for row, one in where.items():
            np.testing.assert_allclose(one.position, there[row].position, atol=1e-3)
            np.testing.assert_allclose(one.covariance, there[row].covariance, atol=1e-3)
            assert np.cos(one.yaw - there[row].yaw) == pytest.approx(1.0, abs=1e-6)


def test_where_nothing_can_be_written_each_process_compiles_for_itself(monkeypatch):
    """A package of root's, a user without a home: numba refuses to keep anything, and the robot must still be found."""
    kept = []

    def njit(cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        kept.append(options)
        return lambda work: work

    from semloc_core.matching.layout.compiled.kernel import kernel

    monkeypatch.setattr(numba, "njit", njit)
    assert kernel(len) is len
    assert kept == [{"nogil": True, "error_model": "numpy"}]
