"""The line "lost or changed?": silent where nothing changed, and it names the class that did."""

import numpy as np
import pytest
from scipy.spatial.distance import jensenshannon
from small_building import CLASSES, building_update, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.explain.class_shift import FEWEST, ClassShift, jensen_shannon
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.localiser import Localiser


@pytest.fixture(scope="module", params=["paper", "rings"])
def world(request, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / "home.map"
    return make_map(path, make_model(request.param), home=building_update(objects=40), other=building_update(seed=3))


def walk(world, update):
    """Localise at every place of a building, and take each answer in."""
    shift, localiser = ClassShift(world), Localiser(world, LocaliserConfig())
    localiser.update(update)
    for place in [p.id for p in update.places]:
        located = localiser.locate(place)
        if located.best_row is not None:
            why = localiser.explain(located)
            shift.see("home", [name for name in located.query.class_names if name])
            shift.explain("home", {part.class_: part.share for part in why.classes})
    return shift


def test_the_distance_is_scipys_and_its_parts_sum_to_the_divergence():
    rng = np.random.default_rng(0)
    for _ in range(50):
        p, q = (rng.random(7) * (rng.random(7) > 0.3) + [1e-3, 0, 0, 0, 0, 0, 0] for _ in range(2))
        distance, parts = jensen_shannon(p, q)
        assert distance == pytest.approx(jensenshannon(p, q, base=2), abs=1e-9)
        assert parts.sum() == pytest.approx(distance**2)
        assert (parts >= 0).all()
    assert jensen_shannon(np.array([1.0, 0.0]), np.array([0.0, 2.0]))[0] == pytest.approx(1.0)


def test_an_unchanged_building_is_as_usual(world):
    shift = walk(world, building_update(objects=40))
    for found in (shift.objects(), shift.attributions()):
        assert found.building == "home"
        assert found.distance <= 0.1 < found.usual


def test_classes_that_came_and_went_are_named(world):
    before = building_update(objects=40)
    changed = [type(o)(o.id, "plant" if o.class_ != "chair" else "chair", o.position) for o in before.objects]
    update = type(before)(**{f: getattr(before, f) for f in before.__struct_fields__} | {"objects": changed})
    found = walk(world, update).objects()
    assert found.distance > found.usual
    assert set(list(found.classes)[:3]) == {"plant", "couch", "painting"}
    assert found.classes["plant"] > 0 > max(found.classes["couch"], found.classes["painting"])
    assert "more plant (+" in found.describe()


def test_a_class_that_the_map_lacks_counts(world):
    shift = ClassShift(world)
    for _ in range(FEWEST):
        shift.see("home", ["piano"])
    found = shift.objects()
    assert found.distance == pytest.approx(1.0)
    assert found.classes["piano"] == pytest.approx(1.0)


def test_nothing_is_said_of_few_answers_or_of_places_without_objects(world):
    shift = ClassShift(world)
    assert shift.objects() is None
    for _ in range(FEWEST - 1):
        shift.see("home", ["chair"])
    assert shift.objects() is None
    for _ in range(100):
        shift.see("home", [])
    assert shift.objects() is None


def test_synonyms_are_one_class(tmp_path):
    space = Labelspace("test", CLASSES, synonyms={"sofa": "couch"})
    world = make_map(tmp_path / "home.map", make_model(space=space), home=building_update())
    shift = ClassShift(world)
    for _ in range(FEWEST):
        shift.see("home", ["sofa", "couch"])
        shift.explain("home", {"sofa": 0.5, "couch": 0.5})
    assert "sofa" not in shift.objects().classes
    assert shift.attributions().classes["couch"] > 0
