"""What a robot's detector calls things is joined to the map's names by the localiser's own options."""

import msgspec
import pytest
from small_building import SPACE, building_update, delta, make_map, make_model

from semloc_core.config import LocaliserConfig
from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.localiser import Localiser
from semloc_core.wire import Object

AUTO = LocaliserConfig(synonyms="auto")
OTHERS = {"couch": "settee", "painting": "picture", "plant": "houseplant"}
"""Other names of the map's classes, which the cross-walk knows."""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    return make_map(tmp_path_factory.mktemp("maps") / "rings.map", make_model("rings"), home=building_update())


def renamed(update, names=OTHERS):
    things = [msgspec.structs.replace(thing, class_=names.get(thing.class_, thing.class_)) for thing in update.objects]
    return msgspec.structs.replace(update, objects=things)


def classes(localiser):
    return [thing.class_ for thing in localiser.live.graph.objects.values()]


def test_other_names_are_the_maps_by_the_cross_walk(loaded):
    same, other, deaf = Localiser(loaded), Localiser(loaded, AUTO), Localiser(loaded)
    expected = same.update(building_update())
    assert other.update(renamed(building_update())).matches == expected.matches
    assert other.live.unknown_classes == {}
    assert deaf.update(renamed(building_update())).matches != expected.matches
    assert set(deaf.live.unknown_classes) == set(OTHERS.values())


def test_names_that_may_be_several_classes_go_by_the_maps_counts(loaded):
    localiser = Localiser(loaded, AUTO)
    localiser.apply(building_update())
    localiser.apply(delta(1, objects=[Object("new", "otherprop", (0.0, 0.0, 0.0))], edges=[("p0", "new")]))
    assert localiser.live.graph.objects["new"].labels == {"plant": 1.0}


def test_a_file_joins_names_and_a_labelspace_names_numbers(loaded, tmp_path):
    (tmp_path / "names.yaml").write_text("synonyms: {divan: couch}")
    (tmp_path / "space.yaml").write_text("name: mine\nclasses:\n- {name: plant, ids: [7]}\n")
    config = LocaliserConfig(synonyms=str(tmp_path / "names.yaml"), labelspace=str(tmp_path / "space.yaml"))
    localiser = Localiser(loaded, config)
    localiser.apply(renamed(building_update(), {"couch": "divan", "plant": "class_7"}))
    assert classes(localiser) == [thing.class_ for thing in building_update().objects]


@pytest.mark.parametrize("text", ["synonyms: {divan: zeppelin}", "nothing of the kind", None])
def test_what_can_not_be_read_is_refused_at_once(loaded, tmp_path, text):
    path = tmp_path / "names.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(LabelspaceError, match="expected"):
        Localiser(loaded, LocaliserConfig(synonyms=str(path)))


def test_other_words_read_the_graph_that_is_there(loaded, tmp_path):
    """Of labels that were read one way it is known what they were, also where an update has changed them since."""
    (tmp_path / "names.yaml").write_text("synonyms: {settee: plant}")
    plain, auto = Localiser(loaded), Localiser(loaded, AUTO)
    plain.apply(renamed(building_update()))
    was = classes(plain)
    auto.take_over(plain)
    assert classes(auto) == [thing.class_ for thing in building_update().objects]
    key = next(thing.id for thing in building_update().objects if thing.class_ == "couch")
    auto.apply(delta(1, objects=[Object(key, "chair", (0.0, 1.0, 0.0))], edges=[("p0", key)]))
    other = auto.renewed(LocaliserConfig(synonyms=str(tmp_path / "names.yaml")))
    other.take_over(auto)
    graph, first = other.live.graph, building_update().objects
    for thing in first:
        name = OTHERS.get(thing.class_, thing.class_)
        assert graph.objects[thing.id].class_ == ("chair" if thing.id == key else {"settee": "plant"}.get(name, name))
    back = other.renewed(LocaliserConfig())
    back.take_over(other)
    assert classes(back) == ["chair" if thing.id == key else name for thing, name in zip(first, was, strict=True)]
    back.update(delta(2, query="p4", removed_nodes=[key]))
    auto = back.renewed(AUTO)
    auto.take_over(back)
    always = Localiser(loaded)
    always.apply(building_update())
    always.apply(delta(1))
    expected = always.update(delta(2, query="p4", removed_nodes=[key])).matches
    assert auto.locate().matches.matches == expected.matches


def test_another_maps_words(loaded, tmp_path):
    """The robot goes on in a map that has a class less: what was read by the first map's names is read anew."""
    fewer = Labelspace("fewer", tuple(name for name in SPACE.classes if name != "couch"))
    second = make_map(tmp_path / "fewer.map", make_model("rings", space=fewer), home=building_update())
    old, new = Localiser(loaded, AUTO), Localiser(second, AUTO)
    old.apply(renamed(building_update()))
    new.take_over(old)
    assert {"settee", "plant", "painting", "chair"} == set(classes(new))
    assert set(new.live.unknown_classes) == {"settee"}


def test_a_file_that_is_gone_since_ends_nothing(loaded, tmp_path):
    path = tmp_path / "names.yaml"
    path.write_text("synonyms: {divan: couch}")
    localiser = Localiser(loaded, LocaliserConfig(synonyms=str(path)))
    path.unlink()
    again = localiser.renewed()
    again.apply(renamed(building_update(), {"couch": "divan"}))
    assert classes(again) == [thing.class_ for thing in building_update().objects]
    with pytest.raises(LabelspaceError):
        localiser.renewed(LocaliserConfig(synonyms=str(tmp_path / "others.yaml")))
