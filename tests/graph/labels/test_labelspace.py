"""Labelspaces: strict files, names that stay, and a hash that changes exactly when an embedding's meaning does."""

from dataclasses import replace

import pytest

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.files import load_labelspace, load_synonyms, shipped_labelspaces
from semloc_core.graph.labels.labelspace import Labelspace, count_unknown
from semloc_core.graph.labels.union import labelspace_from_hydra, union
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.wire import Object

SPACE = Labelspace(
    "test",
    ("chair", "couch", "plant"),
    ids={"chair": (5,), "couch": (7, 8)},
    mobility={"chair": 0.5},
    synonyms={"sofa": "couch"},
)


def write(tmp_path, text):
    path = tmp_path / "space.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def refused(tmp_path, text, *words):
    with pytest.raises(LabelspaceError) as caught:
        load_labelspace(write(tmp_path, text))
    line = str(caught.value)
    assert line.startswith("expected ")
    assert "\n" not in line
    for word in ("space.yaml", *words):
        assert word in line, line


def test_names_synonyms_and_ids_lead_to_classes():
    assert len(SPACE) == 3
    assert [SPACE.index(n) for n in ("chair", "couch", "sofa", "lamp")] == [0, 1, 1, -1]
    assert [SPACE.name_of(i) for i in (5, 7, 8, 9)] == ["chair", "couch", "couch", None]
    assert [SPACE.mobility_of(n) for n in ("chair", "plant")] == [0.5, 0.1]


def test_the_hash_is_of_names_in_order_and_of_nothing_else():
    assert SPACE.hash != replace(SPACE, classes=("couch", "chair", "plant")).hash
    assert SPACE.hash != replace(SPACE, classes=(*SPACE.classes, "lamp")).hash
    same = replace(SPACE, name="other", ids={}, mobility={}, synonyms={}, default_mobility=1.0)
    assert SPACE.hash == same.hash
    assert SPACE.hash == "07328e7553eb06492934d0aadd4d602cbab2e02a699377c9409e455d4f8de102"


@pytest.mark.parametrize("name", shipped_labelspaces())
def test_what_is_shipped_loads_and_every_class_has_id_and_mobility(name):
    space = load_labelspace(name)
    assert space.name == name
    assert set(space.ids) == set(space.mobility) == set(space.classes)


def test_shipped_labelspaces_say_what_their_sources_say():
    assert shipped_labelspaces() == ("coco", "mpcat40", "uhumans2_apartment", "uhumans2_office")
    office = load_labelspace("uhumans2_office")
    paper = {5: "chair", 8: "couch", 10: "computer", 11: "plant", 12: "painting", 18: "trash can"}
    hydra = {5: "chair", 6: "bench", 7: "couch", 10: "computer", 12: "painting", 13: "plant", 18: "trash can"}
    for number, name in [*paper.items(), *hydra.items()]:
        assert office.name_of(number) == name
    assert office.index("trashcan") == office.index("trash can")
    coco = load_labelspace("coco")
    assert len(coco) == 80
    assert [coco.name_of(i) for i in (0, 56, 79)] == ["person", "chair", "toothbrush"]
    mpcat40 = load_labelspace("mpcat40")
    assert len(mpcat40) == 40
    assert [mpcat40.name_of(i) for i in (1, 3, 22, 40)] == ["wall", "chair", "tv_monitor", "misc"]


def test_a_file_of_ones_own(tmp_path):
    text = "name: mine\nclasses:\n- {name: chair, ids: [1, 2], mobility: 0.5}\n- name: Küche\nsynonyms: {seat: chair}"
    space = load_labelspace(write(tmp_path, text))
    assert space == Labelspace("mine", ("chair", "Küche"), {"chair": (1, 2)}, {"chair": 0.5}, {"seat": "chair"})


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("name: x\nclasses: [{name: a}, {name: a}]", "'a' 2 times"),
        ("name: x\nclasses: [{name: ''}]", "with a name"),
        ("name: x\nclasses: [{name: a, ids: [1]}, {name: b, ids: [1]}]", "1 of 'a' and 'b'"),
        ("name: x\nclasses: [{name: a, ids: [1, 1]}]", "1 of 'a' and 'a'"),
        ("name: x\nclasses: [{name: a, ids: [-1]}]", "-1 of 'a'"),
        ("name: x\nclasses: [{name: a, ids: [4294967296]}]", "32 bits"),
        ("name: x\nclasses: [{name: a, mobility: -0.1}]", "at least 0 m"),
        ("name: x\nclasses: [{name: a, mobility: .nan}]", "at least 0 m"),
        ("name: x\nclasses: [{name: a}]\ndefault_mobility: .inf", "at least 0 m"),
        ("name: x\nclasses: [{name: a}]\nsynonyms: {b: c}", "'c', which is none"),
        ("name: x\nclasses: [{name: a}, {name: b}]\nsynonyms: {b: a}", "not classes themselves"),
        ("name: x\nclasses: [{name: a, colour: red}]", "colour"),
        ("name: x\nclasses: [{name: on}]", "$.classes[0].name"),
        ("name: x", "classes"),
        ("name: x\nname: y\nclasses: []", "'name' stands twice"),
        ("name: x\nclasses: [{name: a}]\nsynonyms: {b: a, b: a}", "'b' stands twice"),
        ("name: [", "space.yaml"),
        ("", "null"),
        ("- 1", "array"),
        ("name: !!python/object/apply:os.getcwd []\nclasses: []", "tag"),
        ("? [1]\n: 2", "space.yaml"),
    ],
)
def test_a_file_that_is_not_right_is_refused_in_one_line(tmp_path, text, word):
    refused(tmp_path, text, word)


def test_what_is_not_there_is_named_beside_what_is_shipped(tmp_path):
    with pytest.raises(LabelspaceError, match=r"coco, mpcat40.*\(got 'nowhere'\)"):
        load_labelspace("nowhere")
    with pytest.raises(LabelspaceError, match="got: Is a directory"):
        load_synonyms(tmp_path)


def test_a_synonym_file_joins_a_detector_to_a_map(tmp_path):
    synonyms = load_synonyms(write(tmp_path, "synonyms: {seat: chair, sofa: couch}"))
    joined = SPACE.with_synonyms(synonyms)
    assert joined.index("seat") == 0
    assert joined.hash == SPACE.hash


def test_synonyms_of_no_class_are_refused():
    with pytest.raises(LabelspaceError, match="'stool'"):
        SPACE.with_synonyms({"seat": "stool"})


def test_later_synonyms_win_over_synonyms_classes_and_numbers():
    """They are what a person says; a class that is joined to another is meant no more, in whatever spelling."""
    assert SPACE.with_synonyms({"sofa": "chair"}).index("sofa") == 0
    assert SPACE.with_synonyms({"SOFA": "chair"}).index("sofa") == 0
    joined = SPACE.with_synonyms({"CHAIR": "couch", "class_7": "plant"})
    assert [joined.index(name) for name in ("chair", "Chair", "class_7", "class_8")] == [1, 1, 2, 1]
    assert joined.name_of(7) == "plant"
    assert joined.hash == SPACE.hash


@pytest.mark.parametrize(
    ("name", "of"),
    [
        ("Trash_Can", "trash can"),
        ("trash-can", "trash can"),
        ("TRASHCAN", "trash can"),
        ("trash\u2011can", "trash can"),
        ("Cafe\u0301 TISCH", "caf\u00e9 tisch"),
        ("STRASSE", "stra\u00dfe"),
        ("\uff34\uff36", "tv"),
    ],
)
def test_names_that_differ_in_case_and_joints_alone_are_one_name(name, of):
    space = Labelspace("s", ("lamp", of), synonyms={"Light-Source": "lamp"})
    assert space.index(name) == 1
    assert space.canonical(name) == of
    assert space.canonical("light source") == "lamp"
    assert space.canonical("lamps") == "lamps"


def test_classes_that_a_model_tells_apart_stay_apart():
    space = Labelspace("s", ("TV", "tv"))
    assert [space.index(name) for name in ("TV", "tv", "Tv")] == [0, 1, 0]


def test_a_number_in_place_of_a_name_is_the_class_of_that_id():
    assert [SPACE.index(name) for name in ("class_5", "8", "Class 7", "class_6", "class_4294967296")] == [
        0,
        1,
        1,
        -1,
        -1,
    ]
    assert Labelspace("s", ("class_5", "x"), {"x": (5,)}).index("class_5") == 0, "a class of that name is that class"


def test_names_in_a_file_that_are_one_name_become_one_class(tmp_path, caplog):
    text = "name: x\nclasses: [{name: TV set, ids: [1]}, {name: lamp}, {name: tv-set, ids: [3], mobility: 2}]"
    space = load_labelspace(write(tmp_path, text + "\nsynonyms: {telly: tv-set}"))
    assert space == Labelspace("x", ("TV set", "lamp"), {"TV set": (1, 3)}, {"TV set": 2.0}, {"telly": "TV set"})
    assert "TV set, tv-set" in caplog.text


def test_a_synonym_file_may_name_numbers_and_no_name_twice(tmp_path):
    assert load_synonyms(write(tmp_path, "synonyms: {7: couch, seat: chair}")) == {"class_7": "couch", "seat": "chair"}
    with pytest.raises(LabelspaceError, match="'SEAT' of several"):
        load_synonyms(write(tmp_path, "synonyms: {seat: chair, SEAT: couch}"))


def test_objects_without_a_name_are_of_no_class():
    own = labelspace_from_hydra("f", [(0, "unknown"), (1, "chair"), (2, "Chair"), (3, ""), (4, " ")], [0, 1, 3])
    assert own.ids == {"chair": (1, 2), "class_3": (3,)}
    objects = {name: Object(name, name, (0.0, 0.0, 0.0)) for name in ("Unknown", "lamp", "chair")}
    assert count_unknown(SceneGraph(objects=objects), SPACE) == {"lamp": 1}
    assert Labelspace("old", ("unknown",)).index("unknown") == 0, "a model that was trained on it keeps it"


def test_a_union_joins_names_that_are_one_name():
    joined = union([Labelspace("a", ("TV", "Sofa"), {"TV": (1,)}), Labelspace("b", ("tv", "couch"), {"tv": (2,)})])
    assert joined.classes == ("Sofa", "TV", "couch")
    assert joined.ids["TV"] == (1, 2)
    with_synonym = union([Labelspace("a", ("couch",), synonyms={"sofa": "couch"}), Labelspace("b", ("SOFA", "tv"))])
    assert with_synonym.classes == ("couch", "tv")


def test_a_files_own_labelspace():
    named = labelspace_from_hydra("f", [(13, "plant"), (5, "chair"), (8, "plant")], [5, 99])
    assert named.classes == ("chair", "plant")
    assert named.ids["plant"] == (8, 13)
    assert labelspace_from_hydra("f", None, [7, 3, 7]).classes == ("class_3", "class_7")
    assert labelspace_from_hydra("f", None, [7]).ids == {"class_7": (7,)}
    assert len(labelspace_from_hydra("f", None, [])) == 0
    with pytest.raises(LabelspaceError, match="3 of 'a' and 'b'"):
        labelspace_from_hydra("f", [(3, "a"), (3, "b")], [])


def test_a_union_does_not_depend_on_the_order_of_files():
    a = Labelspace("a", ("x", "c"), {"x": (1,), "c": (2,)}, {"x": 0.5})
    b = Labelspace("b", ("d", "c"), {"d": (1,), "c": (3,)}, {"c": 0.2}, default_mobility=0.3)
    joined = union([a, b])
    assert joined == union([b, a])
    assert joined.classes == ("c", "d", "x")
    assert joined.ids == {"c": (2, 3)}, "id 1 means two classes: it must not be guessed"
    assert joined.mobility == {"x": 0.5, "c": 0.2}
    assert joined.default_mobility == 0.3


def test_a_union_of_equals_keeps_order_and_hash():
    assert union([SPACE, SPACE]).hash == SPACE.hash


def test_a_union_joins_a_class_that_is_anothers_synonym():
    other = Labelspace("b", ("sofa", "lamp"), {"sofa": (3,)}, {"sofa": 0.7})
    joined = union([SPACE, other])
    assert joined.classes == ("chair", "couch", "lamp", "plant")
    assert joined.ids["couch"] == (3, 7, 8)
    assert joined.mobility["couch"] == 0.7
    assert joined.index("sofa") == joined.index("couch")


def test_a_union_of_contradictions_is_refused():
    with pytest.raises(LabelspaceError, match="'sofa'"):
        union([SPACE, Labelspace("b", ("chair",), synonyms={"sofa": "chair"})])
    with pytest.raises(LabelspaceError, match="one class"):
        union([SPACE, Labelspace("b", ("sofa",), synonyms={"couch": "sofa"})])
    with pytest.raises(LabelspaceError, match="at least one"):
        union([])


def test_unknown_classes_are_counted_and_synonyms_are_known():
    names = ["lamp", "sofa", "gargoyle", "lamp", "chair"]
    objects = {str(i): Object(str(i), name, (0.0, 0.0, 0.0)) for i, name in enumerate(names)}
    assert list(count_unknown(SceneGraph(objects=objects), SPACE).items()) == [("lamp", 2), ("gargoyle", 1)]
