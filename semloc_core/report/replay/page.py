"""The page that plays a replay: one file with its data packed inside, or the same page that a server keeps feeding."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from html import escape
from importlib.resources import files

import msgspec

from semloc_core import __version__
from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.map_database import LoadedMap
from semloc_core.metrics import Row
from semloc_core.report.page import Page
from semloc_core.report.replay.frames import Building, Frame
from semloc_core.report.replay.gathering import ReplayData
from semloc_core.text import percent

MOST_BYTES = 5_000_000
"""Of a page; a replay that takes more is thinned."""
TERMS = (
    ("Place", "A patch of free floor: a node of the scene graph. Neighbouring places are joined where one can walk."),
    (
        "Right",
        f"Within {MATCH_RADIUS_M:g} m of where the robot truly was, in the same building and on the same storey.",
    ),
    ("Wrong", "Any other answer that names a place; one without a place is no answer."),
    (
        "Probability",
        "The localiser's own estimate that a place is right. It is each place's own: places a few metres apart are "
        "right together, so they need not sum to 100%.",
    ),
    (
        "Evidence",
        "What the decision rests on, in nats: how much likelier the place makes what the robot sees, object by object. "
        "An object that should be seen there and is not counts against it. It is a sum.",
    ),
    ("Attention", "What the encoder looked at when it proposed places. It only proposes; the evidence decides."),
    ("Stranger", "An object that the robot sees and nothing mapped explains."),
    ("Elsewhere", "Other places that the answer names, far enough off to be another answer."),
    (
        "Status",
        "match: the answer is accepted; ambiguous: it is not, other places could be it; unknown: nothing to go by, or "
        "probably not in this map; no_graph: updates were missing.",
    ),
)


WEIGHED = "Earlier answers weigh in (filter bayes): probabilities count them, evidence is of one answer."
"""Said of a replay whose answers are weighed by those before them."""


class Content(msgspec.Struct):
    """What the page's script reads.

    Attributes:
        title: of the page.
        frames: the answers; of a live page, none at first.
        buildings: by name; of a live page, none: it asks for them.
        classes: all of the labelspace; their order gives their looks.
        rows: success by distance travelled.
        statuses: of all answers, also those thinned out.
        radius: within which an answer is right, metres.
        facts: lines on the replay; ``lacks``: what the page can't show, and why.
        live: whether more frames come.
        weighed: whether probabilities rest on more than each answer's own evidence.

    """

    title: str
    frames: list[Frame]
    buildings: dict[str, Building]
    classes: tuple[str, ...]
    rows: Sequence[Row]
    statuses: dict[str, int]
    radius: float
    facts: list[str]
    lacks: list[str]
    live: bool = False
    weighed: bool = False


def replay_page(data: ReplayData, loaded: LoadedMap, results_name: str, study: Page | None = None) -> str:
    """The page as HTML: the same for the same results and map.

    Args:
        data: of the replay, see `semloc_core.report.replay.data.read_results`.
        loaded: the map that answered, with its scene graphs.
        results_name: what to call the results.
        study: put under it.

    """
    frames, stride = list(data.frames), data.frames.stride
    while True:
        content = _content(data, loaded, results_name, frames, stride)
        text = _html(content, loaded, study)
        if len(text.encode()) <= MOST_BYTES or len(frames) <= 1:
            return text
        frames, stride = frames[::2], stride * 2


def live_page(loaded: LoadedMap, run_name: str, config: LocaliserConfig | None = None) -> str:
    """The page that asks its server for frames and buildings, see `semloc_core.report.replay.live`.

    Args:
        loaded: the map that answers.
        run_name: what to call the run.
        config: the localiser's options.

    """
    weighed = config is not None and config.filter != "none"
    content = Content(
        title=f"{run_name}, live",
        frames=[],
        buildings={},
        classes=loaded.model.labelspace.classes,
        rows=[],
        statuses={},
        radius=MATCH_RADIUS_M,
        facts=_facts(loaded),
        lacks=[WEIGHED] if weighed else [],
        live=True,
        weighed=weighed,
    )
    return _html(content, loaded, None)


def _content(data: ReplayData, loaded: LoadedMap, name: str, frames: list[Frame], stride: int) -> Content:
    named = {of.map for frame in frames for of in frame.candidates} | {of.truth.map for of in frames if of.truth}
    facts = [f"{data.answers:,} answers"]
    if data.rows:
        right, chance = (percent(_figure(data.rows[-1], name)) for name in ("success@1", "chance"))
        facts.append(f"{right} right, {chance} by chance")
    if data.p50_ms is not None:
        facts.append(f"{data.p50_ms:.1f} ms an answer, median")
    lacks = []
    if stride > 1:
        lacks.append(f"Thinned: one answer in {stride} is shown; figures are of all {data.answers:,}.")
    if not data.run:
        lacks.append(
            "Made without the run: where the seen objects lie, and why not elsewhere, is not known "
            "(semloc report replay --run RUN)."
        )
    if not any(frame.truth for frame in frames):
        lacks.append("The truth is not known: nothing is called right or wrong.")
    elif data.unscored:
        lacks.append(f"Of {data.unscored:,} answers the truth is in no building of this map.")
    if data.weighed:
        lacks.append(
            f"{data.weighed:,} answers are not what the run says at that moment alone: earlier ones weigh in (filter "
            "bayes), or other options do. Probabilities count that; evidence is each answer's own."
        )
    if not data.calibrated:
        lacks.append("The probabilities are not calibrated.")
    return Content(
        title=f"Replay of {name}",
        frames=frames,
        buildings={of: data.buildings.get(of) for of in sorted(named or loaded.buildings[:1])},
        classes=loaded.model.labelspace.classes,
        rows=data.rows,
        statuses=dict(sorted(data.statuses.items())),
        radius=MATCH_RADIUS_M,
        facts=[*facts, *_facts(loaded)],
        lacks=lacks,
        weighed=data.weighed > 0,
    )


def _facts(loaded: LoadedMap) -> list[str]:
    buildings = f"{len(loaded.buildings)} building{'s' if len(loaded.buildings) != 1 else ''}"
    return [f"map {loaded.name}: {loaded.n_places:,} places in {buildings}"]


def _figure(row: Row, name: str) -> float:
    value = row[name]
    return float(value) if isinstance(value, int | float) else float("nan")


def _html(content: Content, loaded: LoadedMap, study: Page | None) -> str:
    folder = files("semloc_core.report")
    packed = base64.b64encode(gzip.compress(msgspec.json.encode(content), 9, mtime=0)).decode()
    model = loaded.model
    made_from = (
        ("Map", f"{loaded.name}, {loaded.hash}"),
        ("Model", f"encoder {model.encoder.name}, {model.hash}"),
        ("Labelspace", f"{model.labelspace.name}: {len(model.labelspace)} classes"),
        ("Software", f"semloc {__version__}"),
    )
    parts = {
        "title": escape(content.title),
        "connect": "'self'" if content.live else "'none'",
        "facts": escape(" · ".join(content.facts)),
        "lacks": "".join(f"<p>{escape(line)}</p>" for line in content.lacks),
        "terms": _defined(TERMS),
        "made": _defined(made_from),
        "study": "" if study is None else _study(study),
        "style": (folder / "page.css").read_text("utf-8") + (folder / "replay/player.css").read_text("utf-8"),
        "script": (folder / "replay/player.js").read_text("utf-8"),
        "data": packed,
    }
    template = (folder / "replay/player.html").read_text("utf-8").split("%%")
    return "".join(parts[piece] if i % 2 else piece for i, piece in enumerate(template))


def _study(study: Page) -> str:
    words = "".join(f"<p>{escape(paragraph)}</p>" for paragraph in study.introduction)
    return (
        f'<section id="study"><h1>{escape(study.title)}</h1>{words}<div class="figures">{study.body()}</div></section>'
    )


def _defined(pairs: Sequence[tuple[str, str]]) -> str:
    return "".join(f"<dt>{escape(term)}</dt><dd>{escape(meaning)}</dd>" for term, meaning in pairs)
