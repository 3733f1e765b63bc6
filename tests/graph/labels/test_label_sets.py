"""The cross-walk: which name of one label set is which of another's; no name leads to a thing of another kind."""

import pytest

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.classes import Reading
from semloc_core.graph.labels.label_sets import CrossWalk, label_sets
from semloc_core.graph.labels.labelspace import Labelspace, folded, load_labelspace
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import Object

COCO = load_labelspace("coco")


def test_sets_are_whole_and_no_name_stands_twice() -> None:
    sizes = {
        "coco": 80,
        "ade20k150": 150,
        "nyu40": 40,
        "scannet20": 20,
        "scannet200": 200,
        "mpcat40": 40,
        "objects365": 365,
    }
    sets = label_sets()
    assert {name: len(sets[name]) for name in sizes} == sizes
    for name, names in sets.items():
        assert len({folded(each) for each in names}) == len(names), name
        assert all(each == each.strip() and each for each in names), name


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("sofa, couch, lounge", "couch"),
        ("Sofa", "couch"),
        ("swivel_chair", "chair"),
        ("armchair", "chair"),
        ("plant, flora, plant life", "potted plant"),
        ("table", "dining table"),
        ("Monitor/TV", "tv"),
        ("television receiver, television, television set, tv, tv set", "tv"),
        ("Luggage", "suitcase"),
        ("fridge", "refrigerator"),
        ("books", "book"),
    ],
)
def test_names_of_other_sets_are_cocos(said, meant) -> None:
    found = CrossWalk(COCO).find(said)
    assert (COCO.canonical(said) if found is None else found) == meant


@pytest.mark.parametrize("said", ["wall", "appliance", "otherprop", "unknown", "class_7", "zeppelin", "", ", ,"])
def test_what_is_none_of_the_maps_classes_or_one_of_several_stays_unknown(said) -> None:
    assert CrossWalk(COCO).find(said) is None


def test_the_nearest_wider_name_is_taken() -> None:
    space = Labelspace("own", ("table", "desk", "appliance", "lamp"))
    walk = CrossWalk(space)
    assert [walk.find(name) for name in ("coffee table", "stove", "sconce")] == ["table", "appliance", "lamp"]
    assert CrossWalk(Labelspace("own", ("armchair", "stool"))).find("chair") is None, "either could be meant"
    assert CrossWalk(Labelspace("own", ("coffee table", "bed"))).find("table") == "coffee table"


def test_it_is_asked_for_by_auto_and_said_in_a_line() -> None:
    labels = Reading.of(None, "auto", COCO).labels()
    assert [labels.name(name) for name in ("sofa bed", "swivel chair", "couch")] == ["sofa bed", "chair", "couch"]
    assert labels.told() == ["names of another label set, read as labelspace coco has them: swivel chair → chair"]
    assert Reading.of(None, None, COCO).labels().name("swivel chair") == "swivel chair", "not unless asked"
    with pytest.raises(LabelspaceError):
        Reading.of(None, "automatic", COCO)


def test_what_the_map_or_a_person_calls_a_thing_wins() -> None:
    space = Labelspace("own", ("stool", "chair", "oven"), synonyms={"stove": "chair"})
    labels = Reading.of(None, "auto", space).labels()
    assert [labels.name(name) for name in ("stool", "stove", "armchair")] == ["stool", "chair", "chair"]


def test_a_sets_name_for_the_rest_may_be_all_that_it_has_no_name_for() -> None:
    space = Labelspace("own", ("chair", "couch", "plant", "dining table", "bench", "vase", "oven"))
    walk = CrossWalk(space)
    assert walk.among("otherprop") == walk.among("otherstructure") == ("plant", "bench", "vase", "oven")
    assert walk.among("objects") == ("bench", "vase"), "Matterport has a plant, and appliances"
    assert walk.find("otherprop") is None
    one = CrossWalk(Labelspace("own", ("chair", "plant")))
    assert (one.find("otherprop"), one.among("otherprop")) == (None, ("plant",)), "it may be nothing that is mapped"
    assert walk.among("zeppelin") == ()


def test_a_wider_name_may_be_any_of_its_kinds_but_those_that_its_set_names() -> None:
    walk = CrossWalk(Labelspace("own", ("handbag", "suitcase", "tv", "oven", "mini fridge")))
    assert walk.among("bag") == ("handbag", "suitcase")
    assert walk.among("appliances") == ("tv", "oven", "mini fridge")
    walk = CrossWalk(Labelspace("own", ("coffee table", "desk")))
    assert walk.find("coffee table") == "coffee table"
    assert CrossWalk(Labelspace("own", ("handbag", "backpack", "suitcase"))).among("sack") == (
        "handbag",
        "backpack",
        "suitcase",
    )


def test_names_that_may_be_several_are_read_by_what_the_map_has() -> None:
    space = Labelspace("own", ("chair", "plant", "vase", "oven", "kite"))
    often = {"chair": 9, "plant": 2, "vase": 5, "oven": 1}
    labels = Reading(auto=True).with_known(space, often).labels()
    things = [
        Object("a", "otherprop", (0.0,) * 3),
        Object("b", "chair", (0.0,) * 3),
        Object("c", "unknown", (0.0,) * 3),
        Object("d", "otherprop", (0.0,) * 3, labels={"otherprop": 0.8, "chair": 0.2}),
    ]
    found = labels.graph(SceneGraph.of([], things, [])).objects
    assert (found["a"].class_, found["a"].labels) == ("vase", {"vase": 0.625, "plant": 0.25, "oven": 0.125})
    assert found["b"] == things[1]
    assert found["c"] == things[2]
    assert found["d"].labels == pytest.approx({"vase": 0.5, "plant": 0.2, "oven": 0.1, "chair": 0.2})
    assert labels.told() == [
        "names that may be any of several classes, by how often the map has each: otherprop → vase or plant or oven"
    ]
    plain = Reading(auto=True).with_known(space).labels()
    assert plain.graph(SceneGraph.of([], things[:1], [])).objects["a"] == things[0], "not where nothing is known of it"
