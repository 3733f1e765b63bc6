"""One order of precedence: what a person says of a label, then the file, then the map; and a line where it decided."""

import pytest

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.classes import Reading, advice, all_unknown
from semloc_core.graph.labels.labelspace import Labelspace

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


def test_the_cause_is_named_where_the_map_knows_nothing():
    assert all_unknown(["class_9", "class_9"], MAP) == (
        "all objects are of classes that the map does not know: class_9 (2)"
    )
    assert all_unknown(["class_9", "sofa"], MAP) is None
    assert all_unknown(["unknown"], MAP) == "the classes of all objects are unknown"
    assert "--labelspace" in advice(["class_9"])
    assert "--synonyms" in advice(["class_9", "desk"])
