"""The cross-walk: which name of one label set is which of another's; no name leads to a thing of another kind."""

import pytest

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.cross_walk import CrossWalk
from semloc_core.graph.labels.files import load_labelspace
from semloc_core.graph.labels.label_sets import label_sets, likely_sets
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.names import folded
from semloc_core.graph.labels.reading import Reading
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


EVEN = dict.fromkeys(("chair", "couch", "plant", "dining table", "bench", "vase", "oven"), 1)


def shares(often, name, *heard):
    """Of a name in a map that has these, as heard among others."""
    walk, space = CrossWalk(Labelspace("own", tuple(often))), Labelspace("own", tuple(often))
    sets = likely_sets([folded(each) for each in heard], [folded(each) for each in heard if space.index(each) < 0])
    return walk.shares(name, often, sets)


def test_a_sets_name_for_the_rest_may_be_all_that_it_has_no_name_for_of_one_sort_rather_than_of_others() -> None:
    found = shares(EVEN, "otherprop")
    assert found == pytest.approx({"oven": 1 / 3.03, "plant": 1 / 3.03, "vase": 1 / 3.03, "bench": 0.03 / 3.03})
    found = shares(EVEN, "otherfurniture")
    assert found == pytest.approx({"bench": 1 / 2.06, "oven": 1 / 2.06, "plant": 0.03 / 2.06, "vase": 0.03 / 2.06})
    assert shares(EVEN, "objects") == pytest.approx({"vase": 1 / 1.03, "bench": 0.03 / 1.03}), (
        "it names plant, appliances"
    )
    assert max(shares(EVEN, "seating").items(), key=lambda item: item[1]) == ("bench", pytest.approx(1 / 1.03))
    assert CrossWalk(COCO).find("otherprop") is None
    one = CrossWalk(Labelspace("own", ("chair", "plant")))
    assert (one.find("otherprop"), one.shares("otherprop", {"plant": 2})) == (None, {"plant": 1.0}), "it may be nothing"
    assert shares(EVEN, "zeppelin") == {}
    assert list(shares({"vase": 5, "plant": 2, "kite": 9}, "otherprop")) == ["kite", "vase", "plant"], (
        "as the map has them"
    )


def test_a_wider_name_may_be_any_of_its_kinds_but_those_that_its_set_names() -> None:
    often = dict.fromkeys(("handbag", "suitcase", "tv", "oven", "mini fridge"), 1)
    assert set(shares(often, "bag")) == {"handbag", "suitcase"}
    assert set(shares(often, "appliances")) == {"tv", "oven", "mini fridge"}
    heard = ("tv_monitor", "appliances", "sofa", "gym_equipment")
    assert set(shares(often, "appliances", *heard)) == {"oven", "mini fridge"}, "Matterport names a television"
    walk = CrossWalk(Labelspace("own", ("coffee table", "desk")))
    assert walk.find("coffee table") == "coffee table"
    assert set(shares(dict.fromkeys(("handbag", "backpack", "suitcase"), 1), "sack")) == {
        "handbag",
        "backpack",
        "suitcase",
    }


def test_what_a_detector_says_tells_which_label_set_it_has() -> None:
    def told(*heard):
        folds = [folded(each) for each in heard]
        foreign = [each for each in folds if COCO.index(each) < 0]
        return [one.rest for likely, one in likely_sets(folds, foreign) if likely == 1.0]

    assert [set(rest) for rest in told("chair", "sofa", "otherprop", "nightstand")] == [
        {"otherstructure", "otherfurniture", "otherprop"}
    ]
    assert told("chair", "couch", "sofa") == [], "one name that the map has not is too little"
    assert told("zeppelin", "dirigible", "balloon pilot", "sofa", "nightstand") == [], "most of it is in no label set"
    assert [set(rest) for rest in told("cabinet", "picture", "otherfurniture")] == [{"otherfurniture"}]
    both = likely_sets(["cabinet", "picture", "otherfurniture"], ["cabinet", "picture", "otherfurniture"])
    assert [likely for likely, _ in both] == [1 / 8, 1.0], "NYU's forty has these too, but would say others as often"


def test_a_name_that_the_map_has_is_also_what_its_detector_has_no_name_of_its_own_for() -> None:
    often = {"table": 6, "coffee table": 3, "desk": 3}
    heard = ("table", "otherfurniture", "bookshelf", "bathtub")
    assert shares(often, "table", *heard) == pytest.approx({"table": 6 / 9, "coffee table": 3 / 9}), "it names a desk"
    assert shares(often, "table") == {"table": 1.0}, "not where nothing is known of the detector"


def test_no_name_is_what_the_detector_has_no_name_for() -> None:
    often = {"chair": 100, "fireplace": 2, "curtain": 2, "vase": 1}
    found = shares(often, "unknown", "sofa", "Power outlet", "Street Lights", "Wild Bird")
    whole = 4 + 0.03 * 101
    assert found == pytest.approx(
        {"chair": 3 / whole, "fireplace": 2 / whole, "curtain": 2 / whole, "vase": 0.03 / whole}
    )
    assert shares(often, "unknown") == {}


def test_names_that_may_be_several_are_read_by_what_the_map_has() -> None:
    space = Labelspace("own", ("chair", "plant", "vase", "bench", "kite"))
    often = {"chair": 9, "plant": 2, "vase": 5, "bench": 1}
    labels = Reading(auto=True).with_known(space, often).labels()
    things = [
        Object("a", "otherprop", (0.0,) * 3),
        Object("b", "chair", (0.0,) * 3),
        Object("c", "unknown", (0.0,) * 3),
        Object("d", "otherprop", (0.0,) * 3, labels={"otherprop": 0.8, "chair": 0.2}),
    ]
    found = labels.graph(SceneGraph.of([], things, [])).objects
    whole = 7.03
    assert found["a"].class_ == "vase"
    assert found["a"].labels == pytest.approx({"vase": 5 / whole, "plant": 2 / whole, "bench": 0.03 / whole})
    assert found["b"] == things[1]
    assert found["c"] == things[2]
    each = {"vase": 4 / whole, "plant": 1.6 / whole, "bench": 0.024 / whole, "chair": 0.2}
    assert found["d"].labels == pytest.approx(each)
    assert labels.told() == [
        "names that may be any of several classes, by how often the map has each: otherprop → vase or plant or bench"
    ]
    plain = Reading(auto=True).with_known(space).labels()
    assert plain.graph(SceneGraph.of([], things[:1], [])).objects["a"] == things[0], "not where nothing is known of it"


def test_what_is_heard_later_tells_more_of_what_is_said_next() -> None:
    space = Labelspace("own", ("tv", "oven", "couch"))
    labels = Reading(auto=True).with_known(space, {"tv": 1, "oven": 1, "couch": 1}).labels()

    def read(*names):
        things = [Object(f"{i}", name, (0.0,) * 3) for i, name in enumerate(names)]
        return [thing.labels or thing.class_ for thing in labels.objects(things)]

    assert read("appliances") == [{"oven": 0.5, "tv": 0.5}]
    assert read("appliances", "gym_equipment", "tv_monitor") == [{"oven": 1.0}, "gym_equipment", "tv"]
