"""The shipped general encoders: small, of generated buildings alone, and picked by the classes of a building."""

import pytest

from semloc_core.encoding.general import FOLDER, general_models, load_general, load_model, pick_general
from semloc_core.encoding.model import Model
from semloc_core.errors import ModelError
from semloc_core.graph.labels.labelspace import load_labelspace


def test_there_is_one_for_coco_and_one_for_the_office_labelspace() -> None:
    assert general_models() == ("coco", "uhumans2_office")
    for name in general_models():
        model = load_general(name)
        assert model.labelspace.hash == load_labelspace(name).hash
        assert model.encoder.name == "geodesic_attention"
        assert model.encoder.dimension == 64
        assert (FOLDER / f"{name}.model").stat().st_size < 1_000_000
        buildings = model.provenance["graphs"]
        assert all(b.rsplit("_", 2)[0] in ("home", "coco_office", "office") for b in buildings), "generated ones only"


def test_the_one_that_knows_the_most_objects_is_picked_and_of_equals_the_narrower() -> None:
    assert pick_general({"chair": 5, "bed": 2, "vase": 3})[::2] == ("coco", 10)
    assert pick_general({"chair": 5, "computer": 9, "trash can": 1})[::2] == ("uhumans2_office", 15)
    assert pick_general({"chair": 5, "couch": 1})[0] == "uhumans2_office"
    assert pick_general({"sofa": 3, "zeppelin": 1})[2] == 3, "synonyms are known, other classes are not"


@pytest.mark.parametrize("objects", [{}, {"class_3": 10}, {"chair": 2, "zeppelin": 3}])
def test_none_is_picked_for_a_building_that_none_knows(objects) -> None:
    with pytest.raises(ModelError, match="--model"):
        pick_general(objects)


def test_a_name_is_a_shipped_one_and_else_a_file(tmp_path) -> None:
    load_general("coco").save(tmp_path / "mine.model")
    assert load_model(str(tmp_path / "mine.model")).hash == load_model("coco").hash
    with pytest.raises(ModelError, match="coco, uhumans2_office"):
        load_general("kitchen")
    with pytest.raises(ModelError, match="expected a model file"):
        load_model("kitchen")
    assert isinstance(load_model("uhumans2_office"), Model)
