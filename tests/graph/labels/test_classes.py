"""One order of precedence: what a person says of a label, then the file, then the map; and a line where it decided."""

import pytest

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.classes import advice, all_unknown
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.reading import Reading
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import Object, decode_update, encode

MAP = Labelspace("map", ("chair", "couch", "bed"), {"chair": (3,), "couch": (11,)}, synonyms={"sofa": "couch"})
FILE = {3: "Bed", 7: "lamp", 11: "class_11"}


def test_the_map_names_numbers_that_nobody_named_and_says_so():
    labels = Reading(known=MAP).labels(FILE)
    assert [labels.number(i) for i in (3, 7, 11, 5)] == ["bed", "lamp", "couch", "class_5"]
    assert labels.told() == ["class numbers without names, read as labelspace map has them: 11 couch"]
    assert [labels.name(name) for name in ("SOFA", "class_3", "3", "zeppelin")] == [
        "couch",
        "chair",
        "chair",
        "zeppelin",
    ]


def test_a_persons_synonyms_win_over_the_file_and_the_maps_numbers_and_classes():
    labels = Reading(synonyms={"class_11": "bed", "LAMP": "bed", "chair": "couch"}, known=MAP).labels(FILE)
    assert [labels.number(i) for i in (11, 7)] == ["bed", "bed"]
    assert labels.name("Chair") == "couch"
    assert labels.told() == []
    with pytest.raises(LabelspaceError, match="'couch'"):
        Reading(synonyms={"lamp": "chair", "chair": "couch"}).with_known(MAP)
    with pytest.raises(LabelspaceError, match="'desk'"):
        Reading(synonyms={"lamp": "desk"}).with_known(MAP)


def test_a_persons_labelspace_wins_over_the_files_names_and_the_maps_numbers():
    said = Labelspace("mine", ("stool", "sofa"), {"stool": (3,), "sofa": (7,)})
    labels = Reading(said=said, known=MAP).labels(FILE)
    assert [labels.number(i) for i in (3, 7, 11)] == ["stool", "couch", "class_11"]
    assert labels.told() == ["--labelspace mine overrules the file's own names: 3 Bed → stool, 7 lamp → couch"]
    both = Reading(said=said, synonyms={"stool": "chair"}, known=MAP).labels(FILE)
    assert both.number(3) == "chair", "names that the labelspace gave are joined too"


def test_a_shipped_labelspace_of_another_numbering_leaves_the_files_names():
    """Homes that number COCO's names otherwise are trained on in COCO's classes."""
    said = Labelspace("coco", ("chair", "bed"), {"chair": (7,), "bed": (8,)})
    labels = Reading(said=said, shipped=True).labels({7: "bed", 8: "chair", 9: ""})
    assert [labels.number(i) for i in (7, 8, 9)] == ["bed", "chair", "class_9"]
    assert labels.told() == ["the file's own class names are kept, since labelspace coco numbers them otherwise"]


def test_what_a_person_said_stays_in_the_map_that_is_built():
    said = Labelspace("mine", ("bed",), {"bed": (5,)}, synonyms={"berth": "bed"})
    space = Reading(said=said, synonyms={"sofa": "chair"}, known=MAP).space
    assert [space.index(name) for name in ("class_5", "class_3", "berth", "sofa")] == [2, -1, 2, 0]
    assert space.hash == MAP.hash


def test_classes_to_work_in_are_those_that_labels_are_read_as():
    own = Labelspace("f", ("Sofa", "lamp"), {"Sofa": (1,), "lamp": (2,)})
    assert Reading(synonyms={"sofa": "couch"}).classes_of([own]).classes == ("couch", "lamp")
    assert Reading().classes_of([own, own]).classes == ("Sofa", "lamp")
    assert Reading(known=MAP).classes_of([own]) == MAP


def read(labels: dict[str, float] | None, class_: str, **said: object) -> Object:
    update = SceneGraph.of(objects=[Object("o", class_, (0.0, 0.0, 0.0), None, labels)]).to_update(0, 0, "odom")
    reader = Reading(**{"known": MAP} | said).labels()
    found = reader.update(update)
    assert reader.graph(SceneGraph.from_update(update)).objects == {"o": found.objects[0]}
    return decode_update(encode(found)).objects[0]


def test_what_an_object_may_be_is_read_like_what_it_is():
    """Labels of one class add up, and the class is the likeliest of what they then are."""
    one = read({"bed": 0.4, "Sofa": 0.25, "class_11": 0.25, "lamp": 0.1}, "bed")
    assert (one.class_, one.labels) == ("couch", {"couch": 0.5, "bed": 0.4, "lamp": 0.1})
    tied = read({"sofa": 0.5, "bed": 0.5}, "sofa")
    assert (tied.class_, tied.labels) == ("couch", {"bed": 0.5, "couch": 0.5}), "the object's own class stays"
    joined = read({"settee": 0.6, "chair": 0.3}, "settee", synonyms={"settee": "chair"})
    assert (joined.class_, joined.labels) == ("chair", {"chair": 0.9})
    thirds = read({"sofa": 0.3335, "couch": 0.3335, "class_11": 0.3335}, "sofa")
    assert thirds.labels == {"couch": 1.0}, "publishers round"


def test_labels_that_are_read_as_no_name_are_the_rest():
    one = read({"Un known": 0.6, "chair": 0.3}, "Un known")
    assert (one.class_, one.labels) == ("chair", {"chair": 0.3})
    none = read({"Un known": 0.6}, "Un known")
    assert none.labels is None
    assert read(None, "unknown").class_ == "unknown"


def test_a_graph_whose_labels_are_the_maps_is_left_as_it_is():
    graph = SceneGraph.of(objects=[Object("o", "chair", (0.0, 0.0, 0.0), None, {"chair": 0.6, "bed": 0.3})])
    assert Reading(known=MAP).labels().graph(graph) is graph


def test_the_cause_is_named_where_the_map_knows_nothing():
    assert all_unknown(["class_9", "class_9"], MAP) == (
        "all objects are of classes that the map does not know: class_9 (2)"
    )
    assert all_unknown(["class_9", "sofa"], MAP) is None
    assert all_unknown(["unknown"], MAP) == "the classes of all objects are unknown"


def test_what_helps_is_named_with_what_is_shipped():
    assert advice(["class_9"]) == (
        "--labelspace says which classes these numbers are: one of coco, mpcat40, uhumans2_apartment, uhumans2_office, "
        "or a YAML file"
    )
    said = advice(["class_9", "desk"])
    assert said.startswith("--synonyms auto joins names of known label sets (coco, mpcat40, ade20k150, ")
    assert said.endswith(" to the map's, --synonyms FILE any others")
