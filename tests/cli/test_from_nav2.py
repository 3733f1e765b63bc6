"""`semloc graph from-nav2`: a grid and a list of objects in one frame become a graph; in two frames they do not."""

import numpy as np
import pytest

from semloc_core.sources import read_hydra


@pytest.fixture
def grid(tmp_path):
    """A free room of 6 × 4 m, walls around it, its corner at (-1, -1)."""
    cells = np.full((80, 120), 254, dtype=np.uint8)
    cells[[0, -1]], cells[:, [0, -1]] = 0, 0
    (tmp_path / "room.pgm").write_bytes(b"P5\n120 80\n255\n" + cells.tobytes())
    words = "image: room.pgm\nresolution: 0.05\norigin: [-1.0, -1.0, 0.0]\nnegate: 0\n"
    path = tmp_path / "room.yaml"
    path.write_text(words + "occupied_thresh: 0.65\nfree_thresh: 0.196\n")
    return path


def test_objects_stand_where_the_list_has_them_among_places_in_free_space(semloc, grid, tmp_path) -> None:
    (tmp_path / "things.csv").write_text("class,x,y,z\nchair,1.0,1.0,0.4\ncouch,4.0,2.0,0.5\n")
    out = tmp_path / "room.json"
    assert semloc("graph", "from-nav2", grid, tmp_path / "things.csv", "-o", out).code == 0
    graph = read_hydra(out).graph
    found = {thing.class_: thing.position for thing in graph.objects.values()}
    assert found == {"chair": (1.0, 1.0, 0.4), "couch": (4.0, 2.0, 0.5)}
    at = np.array(list(graph.places.values()))
    assert ((at[:, :2] > [-0.75, -0.75]) & (at[:, :2] < [4.75, 2.75])).all(), "a place where the robot does not fit"


def test_a_list_in_another_frame_is_refused(semloc, grid, tmp_path) -> None:
    (tmp_path / "far.csv").write_text("class,x,y,z\nchair,100.0,200.0,0.4\n")
    out = tmp_path / "room.json"
    said = semloc("graph", "from-nav2", grid, tmp_path / "far.csv", "-o", out)
    assert said.code == 2
    assert "are both in one frame?" in said.err
    assert not out.exists()
