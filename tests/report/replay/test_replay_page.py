import base64
import gzip
import json
import re
from html.parser import HTMLParser

import pytest
from replay_cases import Step, one_map, walk, write_results

from semloc_core.errors import FileFormatError
from semloc_core.report.kept_page import keep, kept
from semloc_core.report.page import Fact, Page, Section, Table
from semloc_core.report.replay import page as replay_page_module
from semloc_core.report.replay.data import read_results
from semloc_core.report.replay.gathering import FRAMES
from semloc_core.report.replay.page import replay_page
from semloc_core.report.replay.picture import answer_picture
from semloc_core.report.replay.thinned import Thinned

OPTIONAL = {"td", "tr", "th", "thead", "tbody", "p", "dt", "dd", "li"}
EMPTY = {"meta", "br", "path", "use", "rect", "image"}


class Reader(HTMLParser):
    """Checks that what is opened is closed, and collects ids, headings and tables."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows = 0
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id" and value]
        if tag not in OPTIONAL | EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if tag not in OPTIONAL | EMPTY:
            assert self.open.pop() == tag


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A map, and the results of a walk in it."""
    folder = tmp_path_factory.mktemp("walk")
    loaded, _ = one_map(folder)
    return loaded, write_results(folder / "r.mcap", loaded, walk())


@pytest.fixture(scope="module")
def text(walked) -> str:
    loaded, results = walked
    return replay_page(read_results(results, loaded), loaded, "r.mcap")


def content(text: str) -> dict:
    """What a page has packed inside."""
    packed = re.search(r'<script id="data"[^>]*>([^<]*)</script>', text)
    assert packed is not None
    return json.loads(gzip.decompress(base64.b64decode(packed.group(1))))


def test_page_asks_nothing_of_a_network(text):
    assert "://" not in text.replace("http://www.w3.org/2000/svg", "")  # the name of what is drawn; nothing is fetched
    assert not re.search(r"<(link|iframe|object|embed)\b|@import|\bsrc=", text)
    assert "default-src 'none'" in text
    assert "connect-src 'none'" in text


def test_page_says_what_the_bag_says(text):
    told = content(text)
    assert told["statuses"] == {"ambiguous": 3, "match": 8, "unknown": 1}
    assert [of.get("right") for of in told["frames"]] == [i not in (3, 4, 5, 8) for i in range(12)]
    assert told["rows"][-1]["success@1"] == pytest.approx(8 / 12)
    assert told["frames"][3]["off_m"] == 22.0
    assert told["buildings"]["home"]["places"][:2] == [[0.0, 0.0, 0], [1.0, 0.0, 0]]
    assert "67% right" in text
    assert "Made without the run" in text


def test_same_results_same_bytes(walked, text):
    loaded, results = walked
    assert replay_page(read_results(results, loaded), loaded, "r.mcap") == text


def test_without_truth_nothing_is_called_right(tmp_path):
    loaded, _ = one_map(tmp_path)
    steps = [Step([("home", float(i))], None, shares={"chair": 1.0}) for i in range(4)]
    text = replay_page(read_results(write_results(tmp_path / "r.mcap", loaded, steps), loaded), loaded, "r.mcap")
    assert "nothing is called right or wrong" in text
    assert all(of.get("right") is None for of in content(text)["frames"])


def test_buildings_that_nothing_touched_are_not_in_the_page(tmp_path):
    loaded, _ = one_map(tmp_path, "a", "b", "c")
    steps = [Step([("b", 1.0)], ("a", 1.0)), Step([("a", 1.0)], ("a", 1.0))]
    text = replay_page(read_results(write_results(tmp_path / "r.mcap", loaded, steps), loaded), loaded, "r.mcap")
    assert sorted(content(text)["buildings"]) == ["a", "b"]


def test_a_page_that_is_too_large_is_thinned_and_says_so(walked, monkeypatch):
    loaded, results = walked
    monkeypatch.setattr(replay_page_module, "MOST_BYTES", 1)
    text = replay_page(read_results(results, loaded), loaded, "r.mcap")
    assert len(content(text)["frames"]) == 1
    assert "one answer in 16 is shown; figures are of all 12" in text


def test_a_page_is_thinned_no_more_than_its_bound_takes(walked, text, monkeypatch):
    loaded, results = walked
    most = len(text.encode()) - 1
    monkeypatch.setattr(replay_page_module, "MOST_BYTES", most)
    thinned = replay_page(read_results(results, loaded), loaded, "r.mcap")
    assert len(thinned.encode()) <= most
    assert len(content(thinned)["frames"]) == 6
    assert content(thinned)["lacks"][0] == "Thinned: one answer in 2 is shown; figures are of all 12."


def test_an_hour_at_two_hertz_is_shown_whole():
    frames = Thinned(FRAMES)
    for number in range(2 * 3600 + 1):
        frames.add(number)
    assert (frames.stride, len(frames)) == (1, 7201)


def test_names_are_escaped():
    evil = "<script>alert(1)</script>"
    section = Section("k", evil, evil, "", [Table(evil, [{evil: evil}], evil)])
    text = Page(evil, [evil], [Fact(evil, evil)], [section], [(evil, evil)], []).html()
    assert "<script>" not in text
    Reader(text)


def test_picture_is_a_small_png_and_the_same_each_time(walked):
    loaded, results = walked
    data = read_results(results, loaded)
    picture = answer_picture(data, loaded)
    assert picture.startswith(b"\x89PNG")
    assert len(picture) < 200_000
    assert picture == answer_picture(data, loaded)


def test_a_page_is_kept_and_read_again(tmp_path):
    section = Section(
        "s", "figure", "See.", "<svg></svg>", [Table("t", [{"a": 1.5, "b": None, "c": "x"}], "note")], True
    )
    page = Page("title", ["Hello."], [Fact("1", "one")], [section], [("Place", "x")], [("Map", "y")])
    keep(page, tmp_path / "page.json")
    assert kept(tmp_path / "page.json").html() == page.html()


@pytest.mark.parametrize("content", [None, b"{}", b"\xff\xfe", b'{"format": "semloc/page/9", "page": {}}'])
def test_what_is_no_kept_page_is_refused_in_one_line(tmp_path, content):
    if content is not None:
        (tmp_path / "page.json").write_bytes(content)
    with pytest.raises(
        FileFormatError, match=r"^expected a page kept by semloc introspect --keep [^\n]*\(got [^\n]*\)$"
    ):
        kept(tmp_path / "page.json")
