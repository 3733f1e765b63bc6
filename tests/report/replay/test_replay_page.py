import re
from html.parser import HTMLParser

import pytest
from replay_cases import Step, one_map, walk, write_results

from semloc_core.errors import FileFormatError
from semloc_core.report.kept_page import keep, kept
from semloc_core.report.page import Fact, Page, Section, Table, joined
from semloc_core.report.replay.data import read_results
from semloc_core.report.replay.page import replay_page
from semloc_core.report.replay.picture import answer_picture

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
    return replay_page(read_results(results, loaded), loaded, "r.mcap").html()


def test_page_asks_nothing_of_a_network(text):
    assert "://" not in text
    assert not re.search(r"<(script|link|iframe|object|embed)\b|@import|\bsrc=", text)
    for target in re.findall(r'href="([^"]*)"', text):
        assert target.startswith(("#", "data:")), target
    assert "default-src 'none'" in text


def test_page_is_whole_and_its_ids_differ(text):
    reader = Reader(text)
    assert len(reader.ids) == len(set(reader.ids))
    links = [attrs["href"][1:] for tag, attrs in reader.tags if tag == "a"]
    assert set(links) <= set(reader.ids)
    assert len(links) == 8


def test_each_figure_has_heading_sentence_picture_and_table(text):
    sections = re.findall(r'<section id="[^"]*" class="card.*?</section>', text, re.DOTALL)
    assert len(sections) == 8
    for section in sections:
        assert section.count("<h2") == 1
        assert re.search(r"<p>[^<]{40,}</p>", section)
        assert 'role="img" aria-label="' in section
        assert re.search(r"<details.*<table><caption><span>[^<]+</span></caption>", section, re.DOTALL)
    assert text.count("<h1>") == 1


def test_page_says_what_the_bag_says(text):
    assert "8 of 12" in text  # right answers
    assert "<td>wrong" in text
    assert "3 wrong top matches 3 fell on this spot" in re.sub(r"\s+", " ", text)
    assert "<dt>accepted (status match)</dt><dd>67%</dd>" in text


def test_same_results_same_bytes(walked, text):
    loaded, results = walked
    assert replay_page(read_results(results, loaded), loaded, "r.mcap").html() == text


def test_without_truth_nothing_is_called_right(tmp_path):
    loaded, _ = one_map(tmp_path)
    steps = [Step([("home", float(i))], None, shares={"chair": 1.0}) for i in range(4)]
    text = replay_page(read_results(write_results(tmp_path / "r.mcap", loaded, steps), loaded), loaded, "r.mcap").html()
    Reader(text)
    assert "bring no ground truth" in text
    assert 'id="success"' not in text
    assert 'id="confusions"' not in text
    assert "truly right" not in text
    assert "true path" not in text


def test_one_answer_without_a_match_makes_a_page(tmp_path):
    loaded, _ = one_map(tmp_path)
    results = write_results(tmp_path / "r.mcap", loaded, [Step([], None, "no_graph")])
    Reader(replay_page(read_results(results, loaded), loaded, "r.mcap").html())


def test_buildings_that_nothing_touched_are_not_drawn(tmp_path):
    loaded, _ = one_map(tmp_path, "a", "b", "c")
    steps = [Step([("b", 1.0)], ("a", 1.0)), Step([("a", 1.0)], ("a", 1.0))]
    text = replay_page(read_results(write_results(tmp_path / "r.mcap", loaded, steps), loaded), loaded, "r.mcap").html()
    assert "map&#x27;s 3 buildings those are drawn" in text
    assert 'id="where1-figure_1"' in text
    assert 'id="where2-figure_1"' not in text


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


def test_two_pages_as_one():
    def one(key: str) -> Page:
        section = Section(key, f"figure {key}", "See.", tables=[Table("t", [{"a": 1.0, "b": None}])])
        return Page(f"page {key}", ["Hello."], [], [section], [("Place", key), (f"only {key}", "x")], [("Map", key)])

    both = joined(one("one"), one("two"))
    assert both.title == "page one"
    assert [section.key for section in both.sections] == ["one", "second", "two"]
    assert both.terms == (("Place", "one"), ("only one", "x"), ("only two", "x"))
    read = Reader(both.html())
    assert {"one", "second", "two"} <= set(read.ids)
    assert len(read.ids) == len(set(read.ids))


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
