"""The page in a real browser, and what the core put into it; without Chromium only the latter."""

import cmath
import json
import shutil
import threading
import urllib.error
import urllib.request
from itertools import islice
from pathlib import Path

import msgspec
import pytest

from semloc_core.config import LocaliserConfig
from semloc_core.explain import evidence_of
from semloc_core.graph import Reading, short_id
from semloc_core.localiser import Localiser
from semloc_core.map_database import load
from semloc_core.replay import replay
from semloc_core.report.replay.data import has_answers, read_results
from semloc_core.report.replay.frames import Frame
from semloc_core.report.replay.live import Feed, served
from semloc_core.report.replay.page import WEIGHED, live_page, replay_page
from semloc_core.sources import BagWriter, read_messages, read_run
from semloc_core.tracking import FrameFilter

ROOT = Path(__file__).parents[3]
MAP = ROOT / "models" / "office.map"
QUIET = ("quic", "gpu", "background-networking", "component-update", "sync")
FLAGS = ["--no-sandbox", "--no-first-run", *(f"--disable-{what}" for what in QUIET)]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """The map, the first seconds of the shipped run, and its results."""
    folder = tmp_path_factory.mktemp("played")
    with BagWriter(folder / "run.mcap") as bag:
        for message in islice(read_messages(ROOT / "bags" / "office_run.mcap"), 20):  # an update and a truth each
            bag.write_raw(message)
    loaded = load(MAP)
    replay(folder / "run.mcap", loaded, LocaliserConfig(), results=folder / "results.mcap")
    return loaded, folder / "run.mcap", folder / "results.mcap"


@pytest.fixture(scope="module")
def data(case):
    loaded, run, results = case
    return read_results(results, loaded, run=run)


@pytest.fixture(scope="module")
def page(case, data, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(replay_page(data, case[0], "results.mcap"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on this machine: the page is not tried in a browser")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=chromium, headless=True, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def opened(browser, page):
    """Opens the page at a width; what the console says of errors ends the test."""
    said: list[str] = []
    pages = []

    def at(width: int, address: str = ""):
        tab = browser.new_page(viewport={"width": width, "height": 800})
        tab.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.goto(address or page.as_uri())
        tab.wait_for_selector("body[data-ready]")
        pages.append(tab)
        return tab

    yield at
    for tab in pages:
        tab.close()
    assert not said


def test_each_rivals_evidence_is_the_cores_own_and_lays_what_was_seen_where_it_is_explained(case, data):
    loaded, run, _ = case
    localiser, checked = Localiser(loaded), 0
    for frame, item in zip(data.frames, read_run(run), strict=True):
        localiser.apply(item.text)
        if frame.t < 3.0:
            continue
        located = localiser.locate()
        names = data.buildings.get("office").objects
        for candidate in frame.candidates:
            found = evidence_of(located, loaded.row(candidate.map, candidate.place))
            assert candidate.evidence is not None
            assert candidate.evidence.score == pytest.approx(found.score, abs=0.3)
            mapped = dict(zip(found.fragment.object_ids, found.mapped, strict=True))
            got = {
                of[0]: names[number][0] if number >= 0 else None
                for of, number in zip(frame.seen, candidate.evidence.mapped, strict=True)
            }
            assert got == mapped
            x, y, _, yaw = candidate.laid
            for (_, class_, at), number in zip(frame.seen, candidate.evidence.mapped, strict=True):
                if number < 0:
                    continue
                turned = complex(x, y) + complex(at[0], at[1]) * cmath.exp(1j * yaw)
                assert names[number][1] == class_
                assert abs(turned - complex(*names[number][2:4])) < 3.0
                checked += 1
    assert checked > 20


def test_the_run_in_the_results_themselves_is_found(case, data, tmp_path):
    loaded, run, results = case
    with BagWriter(tmp_path / "both.mcap") as bag:
        for message in sorted([*read_messages(run), *read_messages(results)], key=lambda of: of.stamp_ns):
            if message.topic != "/ground_truth":
                bag.write_raw(message)
    both = read_results(tmp_path / "both.mcap", loaded)
    assert both.run
    assert [of.candidates for of in both.frames] == [of.candidates for of in data.frames]
    assert (has_answers(tmp_path / "both.mcap"), has_answers(run)) == (True, False)


def test_where_earlier_answers_weigh_in_the_page_says_so_and_shows_what_the_filter_makes_of_it(tmp_path, monkeypatch):
    # A filter that is not told that the graph began anew: what it makes of this run is another thing than without.
    monkeypatch.setattr(FrameFilter, "forget", lambda self: None)
    files = ROOT / "semloc_core" / "cli" / "demo_files"
    loaded, run, config = load(files / "demo.map"), files / "demo_run.mcap", LocaliserConfig(filter="bayes")
    feed = Feed(loaded, config=config)
    feed.run(run, Reading(known=loaded.model.labelspace))
    replay(run, loaded, config, results=tmp_path / "results.mcap")
    data = read_results(tmp_path / "results.mcap", loaded, run=run)
    live = msgspec.json.decode(feed.frames(0), type=Shown).frames
    alone = Feed(loaded)
    alone.run(run, Reading(known=loaded.model.labelspace))
    without = msgspec.json.decode(alone.frames(0), type=Shown).frames

    def said(frames):
        return [[(of.kind, of.place, of.probability) for of in frame.candidates] for frame in frames]

    assert said(live) == said(data.frames) != said(without)
    best = [frames for frames in zip(live, without, strict=True) if all(of.candidates for of in frames)]
    differ = sum(_best(one) != _best(other) for one, other in best)
    assert differ > 0
    assert data.weighed >= differ / 2
    assert "earlier ones weigh in (filter bayes)" in replay_page(data, loaded, "results.mcap")
    assert WEIGHED in live_page(loaded, "run", config)
    assert WEIGHED not in live_page(loaded, "run", LocaliserConfig())
    replay(run, loaded, LocaliserConfig(), results=tmp_path / "plain.mcap")
    assert read_results(tmp_path / "plain.mcap", loaded, run=run).weighed == 0


class Shown(msgspec.Struct):
    """What a page asks its server for."""

    frames: list[Frame]


def _best(frame):
    return frame.candidates[0].place, frame.candidates[0].probability


def test_it_plays_steps_and_tells_the_time(opened):
    tab = opened(1400)
    first = tab.inner_text("#clock")
    tab.keyboard.press("ArrowRight")
    assert "2 of " in tab.inner_text("#clock") != first
    tab.select_option("#speed", "20")
    tab.click("#play")
    tab.locator("#clock", has_text="10 of 10").wait_for()
    assert tab.locator(".seen").count() > 0
    assert tab.locator(".explains").count() > 0
    assert tab.locator(".bars .name").count() > 0
    assert tab.locator("#robot").count() == 1
    assert "off the truth" in tab.inner_text("#answer")


def test_a_click_on_a_rival_shows_its_evidence_beside_the_answers(opened, data):
    tab = opened(1400)
    number = next(i for i, frame in enumerate(data.frames) if len(frame.candidates) > 1)
    for _ in range(number):
        tab.keyboard.press("ArrowRight")
    frame = list(data.frames)[number]
    assert f"{frame.candidates[0].map}, place {short_id(frame.candidates[0].place)}" in tab.inner_text("#answer")
    assert tab.locator("#whynot table").count() == 0
    tab.locator(".ghost, [data-candidate]").first.click()
    rows = tab.locator("#whynot tbody tr")
    assert rows.count() >= len(frame.seen)
    totals = tab.locator("#whynot tfoot td").all_inner_texts()[1:]
    scores = [float(text.replace("−", "-").replace("+", "")) for text in totals]
    assert scores == pytest.approx([of.evidence.score for of in frame.candidates[:2]], abs=0.06)
    tab.keyboard.press("Escape")
    assert tab.locator("#whynot table").count() == 0


def test_the_keyboard_alone_chooses_a_rival_and_keeps_its_place(opened, data):
    tab = opened(1400)
    number = next(i for i, frame in enumerate(data.frames) if len(frame.candidates) > 1)
    for _ in range(number):
        tab.keyboard.press("ArrowRight")
    reached = set()
    for _ in range(40):
        tab.keyboard.press("Tab")
        reached.add(tab.evaluate("document.activeElement.id || Object.keys(document.activeElement.dataset).join()"))
        drawn = tab.evaluate("getComputedStyle(document.activeElement).outlineStyle")
        assert drawn == "solid" or tab.evaluate("document.activeElement === document.body")
    controls = {"first", "back", "play", "next", "last", "speed", "wrong", "seek", "whole", "in", "out"}
    assert controls | {"rival", "candidate"} <= reached | {"wrong"}, "none is wrong: that one may be disabled"
    for name in ("candidate", "rival"):
        tab.locator(f"[data-{name}='1']").focus()
        tab.keyboard.press("Enter")
        assert tab.locator("#whynot table").count() == 1
        assert tab.evaluate(f"document.activeElement.dataset.{name}") == "1"
        tab.keyboard.press("Escape")
        assert tab.locator("#whynot table").count() == 0
        assert tab.evaluate(f"document.activeElement.dataset.{name}") == "1"


@pytest.mark.parametrize("width", [360, 1400])
def test_nothing_is_wider_than_the_screen_or_too_small_to_read(opened, width):
    tab = opened(width)
    if tab.locator("[data-candidate]").count():
        tab.locator("[data-candidate]").first.click()
    wide = """[...document.querySelectorAll('body *')].filter(e => !e.closest('svg, .scroll, .beside') &&
        e.getBoundingClientRect().right > innerWidth + 0.5).map(e => e.outerHTML.slice(0, 80))"""
    assert tab.evaluate(wide) == []
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    small = """[...document.querySelectorAll('body *')].filter(e => !e.closest('svg, script') && e.childNodes.length &&
        [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()) && parseFloat(getComputedStyle(e).fontSize) < 12)
        .map(e => e.outerHTML.slice(0, 80))"""
    assert tab.evaluate(small) == []


def test_the_live_page_follows_the_run(case, opened):
    loaded, run, _ = case
    feed = Feed(loaded)
    with served(live_page(loaded, "run.mcap"), feed) as address:
        assert address.startswith("http://127.0.0.1:")
        tab = opened(1400, address)
        feed.run(run, Reading(known=loaded.model.labelspace))
        tab.locator("#lacks", has_text="The run is over").wait_for()
        tab.locator("#robot").wait_for(state="attached")  # drawn once the building has come, too
        assert tab.locator("#robot").count() == 1
        tab.close()


def test_a_live_feed_has_what_the_report_has(case, data):
    loaded, run, _ = case
    feed = Feed(loaded)
    with served(live_page(loaded, "run.mcap"), feed) as address:
        thread = threading.Thread(target=feed.run, args=(run, Reading(known=loaded.model.labelspace)))
        thread.start()
        thread.join()
        said = json.loads(_get(f"{address}frames?from=0"))
        assert said["done"]
        assert said["frames"] == json.loads(msgspec.json.encode(list(data.frames)))
        assert json.loads(_get(f"{address}building?name=office"))["name"] == "office"
        for wrong in ("building?name=nowhere", "frames?from=x", "etc"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                _get(address + wrong)
        with pytest.raises(urllib.error.HTTPError, match="403"):  # a name of elsewhere that points here
            urllib.request.urlopen(urllib.request.Request(address, headers={"Host": "elsewhere.example"}))


def _get(address: str) -> bytes:
    with urllib.request.urlopen(address) as answer:
        return answer.read()
