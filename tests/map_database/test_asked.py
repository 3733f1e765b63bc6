"""What is asked of a map in another label set's names is read by what that map has."""

from small_building import building_update, make_map, make_model

from semloc_core.graph import SceneGraph
from semloc_core.map_database import load, reading_for
from semloc_core.wire import Object


def test_names_of_several_classes_go_by_the_counts_of_the_map(tmp_path) -> None:
    path = tmp_path / "home.map"
    make_map(path, make_model("rings"), home=building_update())
    loaded = load(path)
    reading = reading_for(loaded, synonyms="auto")
    things = loaded.graph("home").objects.values()
    assert reading.often is not None
    assert sum(reading.often.values()) == len(things)
    assert all(reading.often[thing.class_] >= 1 for thing in things)
    asked = SceneGraph.of([], [Object("o", "otherprop", (0.0,) * 3)], [])
    found = reading.labels().graph(asked).objects["o"]
    assert (found.class_, found.labels) == ("plant", {"plant": 1.0}), "the others have names of their own there"
    assert reading_for(loaded).often is None, "not unless asked"
