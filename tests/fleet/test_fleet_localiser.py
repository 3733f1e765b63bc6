"""A localiser in a map that it does not hold: it answers as one that does, or not at all."""

import itertools

import msgspec
import numpy as np
import pytest
from small_building import CLASSES, building_update, delta, make_map, make_model

from semloc_core import wire
from semloc_core.config import LocaliserConfig
from semloc_core.encoding.model import embed_graph
from semloc_core.errors import LabelspaceError, MapError, MapUnavailableError
from semloc_core.fleet.file_source import FileSource
from semloc_core.fleet.link import Link
from semloc_core.fleet.localiser import FleetLocaliser
from semloc_core.fleet.narrowing import ShortlistConfig
from semloc_core.fleet.open_map import open_localiser
from semloc_core.graph.arrays import GraphArrays
from semloc_core.graph.scene_graph import SceneGraph
from semloc_core.localiser import Localiser
from semloc_core.map_database import MapDatabase, load
from semloc_core.map_database.history import ClassChange, History, Traversal

NAMES = [f"{site}/{i}" for site in ("hq", "lab") for i in range(4)]
FEW = ShortlistConfig(nearest=40, buildings=3)
CONFIGS = [LocaliserConfig(), LocaliserConfig(rerank="none"), LocaliserConfig(filter="bayes")]


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


class Line(FileSource):
    """A file behind a line that can be cut; counts what is asked of it."""

    def __init__(self, path):
        super().__init__(path)
        self.cut, self.asked, self.closed = False, [], False

    def _over(self, what):
        self.asked.append(what)
        if self.cut:
            raise MapUnavailableError("expected the map's server to answer (got nothing)")

    def model(self):
        self._over("model")
        return super().model()

    def catalogue(self):
        self._over("catalogue")
        return super().catalogue()

    def similar(self, z, k, buildings=None):
        self._over("similar")
        return super().similar(z, k, buildings)

    def objects(self, buildings):
        self._over("objects")
        return super().objects(buildings)

    def fetch(self, building):
        self._over(building)
        return super().fetch(building)

    def close(self):
        self.closed = True


def walk(seed, steps=8, first=3):
    """A robot that knows a corridor and walks along it."""
    yield building_update(seed=seed, query=f"p{first}")
    for i in range(1, steps):
        yield delta(i, query=f"p{first + i}")


def answers(localiser, updates):
    return [localiser.update(update) for update in updates]


def texts(results):
    return [
        [wire.encode(part) for part in (result.matches, result.attributions) if part is not None] for result in results
    ]


@pytest.fixture(scope="module")
def model():
    return make_model("paper")


@pytest.fixture
def path(tmp_path, model):
    make_map(tmp_path / "site.map", model, **{name: building_update(seed=i) for i, name in enumerate(NAMES)})
    return tmp_path / "site.map"


@pytest.fixture
def make(path):
    clocks = itertools.count()

    def made(config=None, limits=FEW, source=None, **options):
        clock = Clock()
        link = Link(source or Line(path), np.random.default_rng(next(clocks)), clock)
        localiser = FleetLocaliser(link, config, limits, **options)
        localiser.clock, localiser.line = clock, link._source
        return localiser

    return made


@pytest.mark.parametrize("config", CONFIGS)
def test_with_all_buildings_on_the_list_the_answers_are_the_files_byte_for_byte(make, path, config):
    updates = list(walk(2))
    there = make(config, ShortlistConfig())
    assert texts(answers(there, updates)) == texts(answers(Localiser(load(path), config), updates))
    assert there.map.hash == load(path).hash
    assert "nearest" not in there.line.asked


@pytest.mark.parametrize("rerank", ["none", "layout"])
def test_on_a_short_list_they_are_those_of_a_file_of_these_buildings(make, path, tmp_path, model, rerank):
    config = LocaliserConfig(rerank=rerank)
    localiser, whole = make(config), load(path)
    files = {}
    updates = list(walk(5, steps=6))
    for i, update in enumerate(updates):
        mine = localiser.update(update).matches
        names = localiser.map.buildings
        assert len(names) == 3
        assert mine.map == wire.MapInfo("site", whole.hash, whole.n_places)
        if names not in files:
            buildings = {name: building_update(seed=NAMES.index(name)) for name in names}
            files[names] = make_map(tmp_path / f"{len(files)}.map", model, **buildings)
        theirs = answers(Localiser(files[names], config), updates[: i + 1])[-1].matches
        assert (mine.matches, mine.rivals, mine.raw_matches) == (theirs.matches, theirs.rivals, theirs.raw_matches)
        assert (mine.status, mine.calibrated) == (theirs.status, theirs.calibrated)


def test_each_building_is_fetched_once(make):
    localiser = make()
    for seed in (0, 5, 0, 5):
        answers(localiser, walk(seed, steps=4))
    fetched = [what for what in localiser.line.asked if "/" in what]
    assert len(fetched) == len(set(fetched))
    assert localiser.line.asked.count("model") == 1


def test_what_is_kept_has_a_bound(make):
    localiser = make(limits=ShortlistConfig(nearest=40, buildings=2, kept_places=90))
    for seed in range(8):
        answers(localiser, walk(seed, steps=2))
        assert localiser.holdings.n_places <= 90
        assert set(localiser.map.buildings) <= {name for name, _ in localiser.holdings._held}


def test_while_the_line_is_cut_nothing_is_answered_and_the_graph_goes_on(make):
    localiser = make()
    updates = list(walk(5, steps=12))
    before = answers(localiser, updates[:3])
    assert before[-1].matches.matches
    localiser.line.cut = True
    for update in updates[3:6]:
        result = localiser.update(update)
        assert (result.matches.status, result.matches.matches, result.matches.raw_matches) == ("no_graph", [], None)
        assert (result.matches.seq, result.attributions) == (update.seq, None)
        assert "expected the map's server to answer" in result.located.query.reason
        assert localiser.live.stream.graph.query_place == update.query_place
    state = localiser.server()
    assert not state.answers
    assert "expected the map's server" in state.line
    localiser.line.cut = False
    localiser.clock.now += 60
    after = localiser.update(updates[6])
    assert after.matches.matches
    assert localiser.server().answers
    whole = make()
    assert after.matches.matches == answers(whole, updates[:7])[-1].matches.matches


def test_a_server_that_does_not_answer_is_asked_ever_more_rarely(make):
    localiser = make()
    localiser.line.cut = True
    updates = walk(0, steps=20)
    localiser.update(next(updates))
    asked = []
    for _ in range(4000):  # a tenth of a second each
        localiser.clock.now += 0.1
        localiser.line.asked.clear()
        localiser.keep_up()
        asked.append(len(localiser.line.asked))
    times = np.flatnonzero(asked) / 10
    pauses = np.diff(times)
    assert pauses.max() <= 36.1
    assert pauses[0] < 2
    assert 15 < len(times) < 25
    assert set(asked) == {0, 1}


def test_who_waits_for_the_server_has_the_same_answers_or_an_end(make, caplog):
    """A replay: an outage must change no answer, and one that lasts must not pass for a robot without a map."""
    localiser, always = make(), make()
    link, slept = localiser._link, []

    def sleep(seconds):
        slept.append(seconds)
        localiser.clock.now += seconds
        localiser.line.cut = localiser.clock.now < back

    link._sleep, link.outage_s = sleep, 60.0
    updates, back = list(walk(5)), 20.0
    localiser.update(updates[0]), always.update(updates[0])
    localiser.line.cut = True
    for update in updates[1:4]:
        assert localiser.update(update).matches == always.update(update).matches
    assert 4 <= len(slept) <= 8
    assert len(caplog.records) == 1, "more than one line for one outage"
    assert "waiting up to 60 s" in caplog.text
    localiser.line.cut, back, before = True, np.inf, localiser.clock.now
    with pytest.raises(MapUnavailableError, match=r"answer .* nor to any question for 60 s"):
        localiser.update(updates[4])
    assert localiser.clock.now - before == pytest.approx(60)


def test_before_the_server_was_ever_there_the_graph_is_followed(make, path):
    config = LocaliserConfig()
    localiser = make(config, ShortlistConfig())
    localiser.line.cut = True
    updates = list(walk(2))
    for result in answers(localiser, updates[:4]):
        assert (result.matches.status, result.matches.map, result.matches.model) == ("no_graph", None, None)
        assert wire.decode(wire.encode(result.matches), wire.PlaceMatches) == result.matches
    localiser.line.cut = False
    localiser.clock.now += 60
    always = Localiser(load(path), config)
    answers(always, updates[:4])
    assert localiser.update(updates[4]).matches == always.update(updates[4]).matches


def test_a_building_that_is_replaced_added_or_removed_is_noticed(make, path, model):
    localiser = make(limits=ShortlistConfig(nearest=40, buildings=8, places=8 * 30))
    updates = walk(5, steps=10)
    assert localiser.update(next(updates)).matches.matches[0].map == "lab/1"
    with MapDatabase.open(path) as database:
        database.remove_building("lab/1")
    gone = localiser.update(next(updates)).matches
    assert "lab/1" not in {match.map for match in gone.matches}
    assert gone.map.places == 7 * 30
    add(path, model, "annexe", 5)
    back = localiser.update(next(updates)).matches
    assert back.matches[0].map == "annexe"
    add(path, model, "annexe", 11, replace=True)
    other = localiser.update(next(updates)).matches
    assert other.map.hash not in (gone.map.hash, back.map.hash)
    row = localiser.map.row("annexe", "p6")
    np.testing.assert_array_equal(localiser.map.embeddings[row], load(path).embeddings[load(path).row("annexe", "p6")])


def add(path, model, name, seed, replace=False, history=None):
    graph = SceneGraph.from_update(building_update(seed=seed))
    arrays = GraphArrays.from_scene_graph(graph, model.labelspace, name)
    with MapDatabase.open(path) as database:
        put = database.replace_building if replace else database.add_building
        put(name, graph, arrays.place_ids, arrays.place_positions, embed_graph(model, arrays))
        if history is not None:
            database.revise_building(name, graph, arrays.place_positions, embed_graph(model, arrays), history)


def test_a_building_that_changes_between_the_search_and_the_fetch_is_fetched_as_it_is(make, path, model):
    class Racing(Line):
        raced = False

        def fetch(self, building):
            if building == "lab/1" and not self.raced:
                self.raced = True
                add(path, model, "lab/1", 9, replace=True)
                super().catalogue()
            return super().fetch(building)

    localiser = make(source=Racing(path))
    answer = localiser.update(building_update(seed=5)).matches
    assert answer.map.hash == load(path).hash
    assert answer.status != "no_graph"


def test_a_building_that_goes_between_the_search_and_the_fetch_is_no_loss(make, path):
    class Racing(Line):
        def fetch(self, building):
            with MapDatabase.open(path) as database:
                if building == "lab/1" and building in database.buildings:
                    database.remove_building(building)
                    super().catalogue()
            return super().fetch(building)

    answer = make(source=Racing(path)).update(building_update(seed=5)).matches
    assert answer.matches
    assert answer.map.places == 7 * 30


def test_a_map_that_is_built_anew_with_another_model_is_followed_from_the_next_answer_on(make, path, tmp_path):
    other = make_model("rings")
    make_map(tmp_path / "anew.map", other, **{name: building_update(seed=i) for i, name in enumerate(NAMES)})

    class Anew(Line):
        def fetch(self, building):
            if (tmp_path / "anew.map").exists():
                (tmp_path / "anew.map").replace(path)
                super().catalogue()
            return super().fetch(building)

    localiser = make(source=Anew(path))
    updates = list(walk(5, steps=3))
    lost = localiser.update(updates[0]).located
    assert (lost.matches.status, lost.matches.matches) == ("no_graph", [])
    assert "built anew" in lost.query.reason
    answer = localiser.update(updates[1]).matches
    assert answer.model.hash == other.hash
    always = make()
    answers(always, updates[:1])
    assert answer.matches == always.update(updates[1]).matches.matches


def test_classes_weigh_as_in_the_whole_map_whatever_is_on_the_list(make, path, model):
    """A building with a history far from the robot's changes what its query is: as with the file."""
    updates = list(walk(5, steps=4))
    plain = load(path).class_weights
    traversal = Traversal("run", 0.0, (0.0, 0.0, 0.0), 0.1, 1, 1, 0, 0, 0, 0)
    history = History((traversal,), {}, {"chair": ClassChange(0.0, 50.0), "couch": ClassChange(50.0, 0.0)})
    localiser = make()
    localiser.update(updates[0])
    add(path, model, "hq/0", 0, replace=True, history=history)
    weighed = localiser.update(updates[1]).matches
    assert "hq/0" not in localiser.map.buildings
    file = Localiser(load(path))
    file.update(updates[0])
    expected = file.update(updates[1]).matches
    by_place = {(m.map, m.place): m.similarity for m in expected.raw_matches}
    shared = [m for m in weighed.raw_matches if (m.map, m.place) in by_place]
    assert shared
    for match in shared:
        assert match.similarity == by_place[match.map, match.place]
    assert localiser.map.class_weights == file.map.class_weights
    assert plain != file.map.class_weights, "the history weighs nothing: nothing was tested"


def test_the_filter_goes_on_when_the_list_changes(make):
    config = LocaliserConfig(filter="bayes", explain_rate_hz=0.0)
    localiser = make(config, ShortlistConfig(nearest=25, buildings=2))
    lists = set()
    updates = walk(5, steps=20)
    for i, update in enumerate(updates):
        if i == 10:  # a longer one
            localiser._limits, localiser._complete = ShortlistConfig(nearest=40, buildings=3), False
        answer = localiser.update(update).matches
        lists.add(localiser.map.buildings)
    assert len(lists) > 1, "the list never changed: nothing was tested"
    assert answer.matches[0].map == "lab/1"
    assert abs(answer.matches[0].position[0] - 22) <= 4
    kept = localiser._filter._kept
    assert {"lab/1"} == set(localiser._filter.buildings(0.5))
    localiser._show(localiser._keys)  # the same list made anew
    assert localiser._filter._kept is kept


def test_only_the_buildings_asked_for(make, path):
    config = LocaliserConfig(buildings=("hq/*",))
    localiser = make(config, ShortlistConfig(nearest=40, buildings=2))
    file = open_localiser(str(path), config)
    assert localiser.update(building_update(seed=5)).matches.matches
    assert localiser.buildings == file.buildings == tuple(NAMES[:4])
    assert localiser.map.all_buildings == file.map.all_buildings == tuple(NAMES)
    for each in (localiser, file):
        found = each.update(building_update(seed=5)).matches
        assert {match.map for match in [*found.matches, *found.raw_matches]} <= set(NAMES[:4])
        assert found.map.places == 8 * 30
        assert found.map.hash == load(path).hash
    with pytest.raises(MapError, match="a pattern that fits a building of the map"):
        open_localiser(str(path), LocaliserConfig(buildings=("attic/*",)))
    lost = make(LocaliserConfig(buildings=("attic/*",))).update(building_update()).located
    assert lost.matches.status == "no_graph"
    assert "attic" in lost.query.reason


def test_no_answer_waits_for_more_than_its_patience(make):
    """What is not there yet is for later answers; the likeliest building comes first."""
    localiser = make(limits=ShortlistConfig(nearest=100, buildings=4), patience_s=-1.0)
    updates = walk(5, steps=8)
    sizes = []
    for update in updates:
        assert localiser.update(update).matches.matches
        sizes.append(len(localiser.map.buildings))
    assert sizes[0] == 1
    assert max(sizes) > 1


def test_other_options_go_on_with_the_same_line(make):
    first = make(LocaliserConfig(filter="bayes"))
    updates = list(walk(5, steps=6))
    answers(first, updates[:3])
    fetched = [what for what in first.line.asked if "/" in what]
    second = first.renewed(LocaliserConfig(filter="bayes", top_n=2))
    second.take_over(first)
    first.close()
    result = second.update(updates[3])
    assert len(result.matches.matches) == 2
    assert result.matches.matches[0].map == "lab/1"
    assert second._filter is first._filter
    again = [what for what in first.line.asked if "/" in what]
    assert len(set(again)) == len(again) >= len(fetched)
    assert not first.line.closed
    second.close()
    assert first.line.closed


def test_a_question_about_another_place_is_answered_and_is_no_observation(make):
    localiser = make(LocaliserConfig(filter="bayes"))
    localiser.update(building_update(seed=5, query="p5"))
    kept = list(localiser._filter._kept)
    assert localiser.ask("p12").matches.matches[0].place is not None
    assert localiser.ask("nowhere").matches.status == "unknown"
    assert localiser._filter._kept == kept
    assert localiser.ask().query.place == "p5"


def test_a_query_without_objects_is_unknown_not_without_a_map(make):
    localiser = make()
    answer = localiser.update(building_update(query=None))
    assert answer.matches.status == "unknown"
    assert answer.matches.map.places == 8 * 30


def renamed(updates):
    """As another detector calls things."""
    names = {"couch": "settee", "painting": "picture", "plant": "otherprop"}
    for update in updates:
        things = [msgspec.structs.replace(o, class_=names.get(o.class_, o.class_)) for o in update.objects]
        yield msgspec.structs.replace(update, objects=things)


@pytest.mark.parametrize("limits", [ShortlistConfig(), FEW])
def test_other_names_are_the_maps_as_soon_as_it_is_known(make, path, limits):
    """Also those of an update that came before: without the server nothing is known of the map's names."""
    localiser, updates = make(LocaliserConfig(synonyms="auto"), limits), list(renamed(walk(5)))
    localiser.line.cut = True
    assert localiser.update(updates[0]).matches.status == "no_graph"
    localiser.line.cut = False
    localiser.clock.now += 60
    found = answers(localiser, updates[1:])
    assert {thing.class_ for thing in localiser.live.graph.objects.values()} <= set(CLASSES)
    assert localiser.live.unknown_classes == {}
    plain = make(None, limits)
    expected = answers(plain, list(walk(5)))[-1].matches
    assert [m.map for m in found[-1].matches.matches] == [m.map for m in expected.matches]
    assert found[-1].matches.matches[0].place == expected.matches[0].place


def test_words_that_the_servers_map_has_no_class_for_are_told_with_every_answer(make, tmp_path):
    (tmp_path / "names.yaml").write_text("synonyms: {settee: zeppelin}")
    config = LocaliserConfig(synonyms=str(tmp_path / "names.yaml"))
    localiser = make(config)
    for result in answers(localiser, list(walk(5, steps=3))):
        assert result.matches.status == "no_graph"
        assert "zeppelin" in result.located.query.reason
    knowing = make()
    answers(knowing, walk(5, steps=2))
    with pytest.raises(LabelspaceError, match="zeppelin"):
        knowing.renewed(config)
    assert knowing.renewed(LocaliserConfig(synonyms="auto")).config.synonyms == "auto"
