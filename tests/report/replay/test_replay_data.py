import math

import pytest
from replay_cases import Step, one_map, walk, write_results
from small_building import CLASSES

from semloc_core.errors import BagError, MapError
from semloc_core.replay.recorded import score_results
from semloc_core.report.replay import data as replay_data
from semloc_core.report.replay.data import read_results
from semloc_core.report.replay.thinned import Thinned


def test_rows_are_those_of_the_replays_own_scoring(tmp_path):
    loaded, _ = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk())
    expected = [{**row, "method": "rings"} for row in score_results(results, ["home"], chance=loaded.chance)]
    assert read_results(results, loaded).rows == expected


@pytest.mark.parametrize("truth_first", [False, True])
def test_each_answer_is_judged_against_the_truth_of_its_own_stamp(tmp_path, truth_first):
    loaded, _ = one_map(tmp_path)
    data = read_results(write_results(tmp_path / "r.mcap", loaded, walk(), truth_first=truth_first), loaded)
    assert [p.right for p in data.frames] == [i not in (3, 4, 5, 8) for i in range(12)]
    assert [p.truth.position[0] for p in data.frames] == [float(i) for i in range(12)]
    assert [p.t for p in data.frames] == [i * 0.5 for i in range(12)]


def test_truth_from_the_run_when_the_results_have_none(tmp_path):
    loaded, _ = one_map(tmp_path)
    run = tmp_path / "run.mcap"
    results = write_results(tmp_path / "r.mcap", loaded, walk(), truths=run)
    assert read_results(results, loaded).rows == []
    assert all(p.right is None for p in read_results(results, loaded).frames)
    whole = write_results(tmp_path / "whole.mcap", loaded, walk())
    assert read_results(results, loaded, run=run).rows == read_results(whole, loaded).rows != []


def test_a_stream_that_starts_again_keeps_its_truths(tmp_path):
    """After a restart stamps go back; a truth seen before must not make a later answer give up on its own."""
    loaded, _ = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk())
    from semloc_core.sources.bag import BagWriter, read_messages

    with BagWriter(tmp_path / "twice.mcap") as bag:
        for _ in range(2):
            for message in read_messages(results):
                bag.write_raw(message)
    data = read_results(tmp_path / "twice.mcap", loaded)
    assert len(data.frames) == 24
    assert [p.right for p in data.frames][12:] == [p.right for p in data.frames][:12]


def test_a_match_in_another_building_has_no_error_in_metres(tmp_path):
    loaded, _ = one_map(tmp_path, "a", "b")
    steps = [Step([("b", 1.0)], ("a", 1.0)), Step([("a", 1.0)], ("a", 1.0)), Step([("a", 1.0)], ("odom", 1.0))]
    data = read_results(write_results(tmp_path / "r.mcap", loaded, steps), loaded)
    assert [p.right for p in data.frames] == [False, True, None]
    assert data.unscored == 1
    assert [p.off_m for p in data.frames] == [None, 0.0, None]


def test_statuses_shares_latency(tmp_path):
    loaded, _ = one_map(tmp_path)
    data = read_results(write_results(tmp_path / "r.mcap", loaded, walk()), loaded)
    assert data.statuses == {"match": 8, "ambiguous": 3, "unknown": 1}
    assert [f.t for f in data.frames if f.attention] == [0.0, 1.0, 2.0, 3.0, 5.0]
    assert next(iter(data.frames)).attention == [(CLASSES[0], 0.75), (CLASSES[1], 0.25)]
    assert data.p50_ms == pytest.approx(7.0, rel=0.02)
    assert data.best is not None
    assert data.best.right is True


def test_a_long_run_is_thinned_but_counted_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(replay_data, "FRAMES", 16)
    loaded, _ = one_map(tmp_path)
    steps = [Step([("home", 1.0)], ("home", 1.0)) for _ in range(100)]
    data = read_results(write_results(tmp_path / "r.mcap", loaded, steps), loaded)
    assert data.answers == 100
    assert len(data.frames) <= 16
    assert [p.t for p in data.frames] == [i * 0.5 * data.frames.stride for i in range(len(data.frames))]
    assert data.rows[-1]["queries"] == 100


def test_answers_of_another_map_are_refused_by_name(tmp_path):
    loaded, _ = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk(), map_hash="f" * 64)
    with pytest.raises(MapError, match=r"expected answers from the map 'small' \w{12} \(got .*f{12}\)"):
        read_results(results, loaded)


def test_a_bag_without_answers_is_refused_with_its_topics(tmp_path):
    loaded, _ = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, walk())
    with pytest.raises(BagError, match=r"expected answers on /robot/matches .*got /ground_truth, /localiser"):
        read_results(results, loaded, node="/robot")


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 100, 1000])
def test_thinned_is_every_stride_th_item_and_never_longer_than_its_limit(count):
    series = Thinned(8)
    for i in range(count):
        series.add(i)
        assert len(series) <= 8
    assert list(series) == list(range(0, count, series.stride))
    assert series.seen == count
    assert series.stride == 1 or math.ceil(count / (series.stride // 2)) > 8, "not thinned more than needed"
