"""One function a section of a replay's page: the drawing, the sentence that says what to see, and the table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from semloc_core.config import MATCH_RADIUS_M
from semloc_core.metrics import Row
from semloc_core.report.colours import OTHER, ClassLooks
from semloc_core.report.drawing import to_svg
from semloc_core.report.floor_plan import Plan, building_figure, confusion_figure, path_figure
from semloc_core.report.page import Section, Table
from semloc_core.report.replay.data import Point, ReplayData, confused_places
from semloc_core.report.replay.time_figures import (
    STATUSES,
    Run,
    bracket,
    confidence_figure,
    latency_figure,
    shares_figure,
    status_figure,
    success_figure,
)
from semloc_core.text import percent

CONFUSIONS = 10
"""Spots listed at most among those that wrong answers fell on."""


def share_of(row: Row, figure: str) -> str:
    """A row's figure as a percentage."""
    value = row[figure]
    assert isinstance(value, int | float), value
    return percent(value)


def where(data: ReplayData, plans: Sequence[Plan]) -> Section:
    """Floor plans with the true path and the top matches."""
    points, drawings = list(data.points), []
    for number, plan in enumerate(plans):
        here = [(p, p.match) for p in points if p.match is not None and p.match.map == plan.name]
        at = {verdict: [m.position[:2] for p, m in here if p.right is verdict] for verdict in (True, False, None)}
        chances = [m.probability for p, m in here if p.right is None]
        path = _path(points, plan.name)
        good = [verdict for _, verdict in path]
        drawn = path_figure(plan, [xy for xy, _ in path], good, at[True], at[False], at[None], chances)
        known = "the robot's true path and " if path else ""
        drawings.append(
            to_svg(
                drawn,
                f"where{number}",
                f"Floor plan of {plan.name} with {known}{len(here)} top matches: {len(at[True])} right, "
                f"{len(at[False])} wrong, {len(at[None])} that can't be judged.",
            )
        )
    judged = [p for p in points if p.right is not None]
    if judged:
        sentence = (
            f"The line is where the robot truly went, thick where the answer was within {MATCH_RADIUS_M:g} m of the "
            f"truth ({sum(bool(p.right) for p in judged)} of {len(judged)}); discs are the places that right answers "
            "named, crosses those that wrong ones named, the larger the more often."
        )
    else:
        sentence = (
            "Each disc is a place where an answer put the robot, the lighter the more probable; the results bring no "
            "ground truth, so nothing says which are right."
        )
    rows: list[Row] = [_answer_row(p) for p in points]
    return Section(
        "where", "Where the robot was, and where it was put", sentence, "".join(drawings),
        [Table("Answers: where the robot was, and the top match (m)", rows, _note(data))], wide=len(plans) > 1,
    )  # fmt: skip


def _path(points: Sequence[Point], building: str) -> list[tuple[tuple[float, float], bool]]:
    """True positions in one building and whether the answer there was right; NaN between two stretches."""
    path: list[tuple[tuple[float, float], bool]] = []
    for point in points:
        if point.truth is not None and point.truth[0] == building:
            path.append((point.truth[1][:2], bool(point.right)))
        elif path and not math.isnan(path[-1][0][0]):
            path.append(((math.nan, math.nan), False))
    return path


def _answer_row(point: Point) -> Row:
    row: Row = {"time_s": point.seconds}
    row |= {"true_x": None, "true_y": None, "match_x": None, "match_y": None}
    if point.truth is not None:
        row |= {"true_x": point.truth[1][0], "true_y": point.truth[1][1]}
    if point.match is not None:
        row |= {"match_x": point.match.position[0], "match_y": point.match.position[1]}
    verdict = {True: "right", False: "wrong", None: "–"}[point.right]
    match = "–" if point.match is None else f"{point.match.place} ({point.match.map})"
    return row | {"verdict": verdict, "top match": match}


def success(data: ReplayData) -> Section | None:
    """Success by distance travelled."""
    if not data.rows:
        return None
    total = data.rows[-1]
    rows: list[Row] = []
    for row in data.rows:
        rows.append({"travelled": bracket(str(row["scope"]))})
        rows[-1] |= {name: value for name, value in row.items() if name not in ("method", "scope")}
    return Section(
        "success",
        "How often it was right, by distance travelled",
        f"Over the whole walk the first place named was right in {share_of(total, 'success@1')} of the answers and one "
        f"of the first ten in {share_of(total, 'success@10')}; bars that rise to the right say that seeing more helps.",
        to_svg(success_figure(data.rows), "success", f"Bars of success by distance travelled; {_spoken(rows)}"),
        [
            Table(
                "Success by distance travelled",
                rows,
                "answered: share of updates with any match listed; accepted: share with status match; precision: "
                "share of the accepted ones that are right.",
            )
        ],
        open=True,
    )


def _spoken(rows: Sequence[Row]) -> str:
    return "; ".join(f"{row['travelled']}: success@1 {share_of(row, 'success@1')}" for row in rows)


def confidence(data: ReplayData) -> Section:
    """Similarity and probability over time."""
    points = list(data.points)
    similar = [p.match.similarity if p.match is not None else math.nan for p in points]
    probable = [p.match.probability if p.match is not None else math.nan for p in points]
    seconds = [p.seconds for p in points]
    rows: list[Row] = [
        {"time_s": t, "similarity": s, "probability": q} for t, s, q in zip(seconds, similar, probable, strict=True)
    ]
    return Section(
        "confidence",
        "How sure it was",
        "The solid line says how alike the robot's surroundings and the best place of the map are, the dashed one how "
        "probable it is that this place is right: alike but improbable means that many places are as much alike"
        + ("." if data.calibrated else " (the probabilities of this map are not calibrated)."),
        to_svg(
            confidence_figure(seconds, similar, probable),
            "confidence",
            f"Lines of similarity and probability of the top match over {seconds[-1]:.0f} seconds.",
        ),
        [Table("Similarity and probability of the top match", rows, _note(data))],
    )


def statuses(data: ReplayData) -> Section:
    """Statuses over time."""
    points = list(data.points)
    runs = list(_runs(points, [p.status for p in points]))
    verdicts = [str(p.right) for p in points]
    right = [(start, end) for verdict, start, end in _runs(points, verdicts) if verdict == "True"]
    shares = {name: data.statuses[name] / data.answers for name in STATUSES if data.statuses[name]}
    said = ", ".join(f"{name} {percent(share)}" for name, share in shares.items())
    counts: list[Row] = [
        {"status": name, "answers": data.statuses[name], "share": data.statuses[name] / data.answers}
        for name in STATUSES
    ]
    stretches: list[Row] = [{"status": name, "from_s": start, "to_s": end} for name, start, end in runs]
    return Section(
        "statuses",
        "What it answered",
        f"Each lane is filled while the answers had that status ({said}); a robot should act on a match only"
        + (", and the lowest lane says when the top match was truly right." if data.rows else "."),
        to_svg(
            status_figure(runs, right if data.rows else None), "statuses", f"Status of the answers over time: {said}."
        ),
        [Table("Statuses", counts), Table("Stretches of equal status", stretches, _note(data))],
    )


def _runs(points: Sequence[Point], names: Sequence[str]) -> Iterator[Run]:
    """Stretches of equal names; the last answer is taken to hold as long as the one before."""
    last = points[-1].seconds - points[-2].seconds if len(points) > 1 else 1.0
    ends = [*(point.seconds for point in points[1:]), points[-1].seconds + max(last, 0.0)]
    start = points[0].seconds
    for i, name in enumerate(names):
        if i + 1 == len(names) or names[i + 1] != name:
            yield name, start, ends[i]
            start = ends[i]


def shares(data: ReplayData, classes: ClassLooks) -> Section | None:
    """Class shares over time."""
    series = list(data.shares)
    if not series:
        return None
    present = [name for name in classes.order if any(name in a.classes for a in series)]
    own, rest = classes.own, classes.rest
    stacked = {name: [a.classes.get(name, 0.0) for a in series] for name in own if name in present}
    if set(rest) & set(present):
        stacked[OTHER] = [sum(a.classes.get(name, 0.0) for name in rest) for a in series]
    means = {name: sum(a.classes.get(name, 0.0) for a in series) / len(series) for name in present}
    first = max(means, key=lambda name: means[name])
    rows: list[Row] = [
        {"time_s": a.seconds, **{name: values[i] for name, values in stacked.items()}} for i, a in enumerate(series)
    ]
    summary: list[Row] = [
        {
            "class": name,
            "mean share": mean,
            "largest share": max(a.classes.get(name, 0.0) for a in series),
            "objects at most": max(a.instances.get(name, 0) for a in series),
        }
        for name, mean in means.items()
    ]
    note = f"Every {data.shares.stride}th of {data.shares.seen:,} attributions." if data.shares.stride > 1 else ""
    return Section(
        "shares",
        "Which classes carried the answers",
        f"The higher a band, the more of the comparison that class of objects carried at that moment; on average most "
        f"was carried by {first} ({percent(means[first])}).",
        to_svg(
            shares_figure([a.seconds for a in series], stacked, classes),
            "shares",
            "Stacked areas of class shares over time. Means: "
            + ", ".join(f"{name} {percent(mean)}" for name, mean in means.items()),
        ),
        [Table("Shares over the whole walk", summary, note), Table("Shares over time", rows, note)],
    )


def confusions(data: ReplayData, plans: Sequence[Plan]) -> Section | None:
    """The places that wrong answers fell on most."""
    if not data.wrong:
        return None
    ranked = confused_places(data.wrong)[:CONFUSIONS]
    total = sum(place.count for place in data.wrong.values())
    drawings = []
    for number, plan in enumerate(plans):
        here = [(i, w) for i, ((building, _), w) in enumerate(ranked, start=1) if building == plan.name]
        if here:
            drawn = confusion_figure(
                plan, [w.position[:2] for _, w in here], [w.count for _, w in here], [i for i, _ in here]
            )
            said = f"Floor plan of {plan.name} with the {len(here)} spots that wrong answers fell on most."
            drawings.append(to_svg(drawn, f"confusions{number}", said))
    rows: list[Row] = [
        {
            "number": number,
            "place": place,
            "building": building,
            "x": w.position[0],
            "y": w.position[1],
            "times": w.count,
            "share of wrong": w.count / total,
            "mean error (m)": w.mean_error_m,
            "from elsewhere": w.elsewhere,
        }
        for number, ((building, place), w) in enumerate(ranked, start=1)
    ]
    covered = sum(w.count for _, w in ranked)
    return Section(
        "confusions",
        "Where the wrong answers fell",
        f"The larger a disc, the more often the robot was wrongly put there; of {total:,} wrong top matches "
        f"{covered:,} fell on {'this spot' if len(ranked) == 1 else f'these {len(ranked)} spots'}: look at what "
        "surrounds them.",
        "".join(drawings),
        [
            Table(
                "Spots that wrong answers fell on most",
                rows,
                f"A spot is a place and what lies within {MATCH_RADIUS_M:g} m of it; mean error: how far from the "
                "robot's true position; from elsewhere: times the robot was in another building.",
            )
        ],
        wide=len(drawings) > 1,
    )


def buildings(plans: Sequence[Plan], classes: ClassLooks, in_map: int) -> Section:
    """What the map knows: places and objects by class."""
    drawings = [
        to_svg(
            building_figure(plan, classes),
            f"building{number}",
            f"Floor plan of {plan.name}: {len(plan.places)} places and objects of {len(plan.objects)} classes.",
        )
        for number, plan in enumerate(plans)
    ]
    rows: list[Row] = [
        {"class": name, **{plan.name: len(plan.objects.get(name, ())) for plan in plans}}
        for name in classes.order
        if any(name in plan.objects for plan in plans)
    ]
    sizes: list[Row] = [
        {"building": plan.name, "places": len(plan.places), "ways between them": len(plan.edges)} for plan in plans
    ]
    left_out = (
        f" Of the map's {in_map} buildings those are drawn that truth or answers touch most."
        if in_map > len(plans)
        else ""
    )
    return Section(
        "map",
        "What the map knows",
        "Dots are places, lines the ways between them, marks the objects by class: only these tell places apart, so a "
        f"part of the building without marks, or with the same marks as another, is hard to recognise.{left_out}",
        "".join(drawings),
        [Table("Objects of each class", rows), Table("Buildings", sizes)],
        wide=len(plans) > 1,
    )


def latency(data: ReplayData) -> Section | None:
    """How long answers took, where they say so."""
    points = [p for p in data.points if p.latency_ms is not None]
    if not points:
        return None
    rows: list[Row] = [{"time_s": p.seconds, "latency_ms": p.latency_ms} for p in points]
    return Section(
        "latency",
        "How long an answer took",
        f"Half of the answers took less than {data.p50_ms:.1f} ms and 99 of 100 less than {data.p99_ms:.1f} ms; a "
        "cloud that rises to the right would say that the work grows with the graph.",
        to_svg(
            latency_figure([p.seconds for p in points], [p.latency_ms or 0.0 for p in points]),
            "latency",
            f"Latency of {len(points)} answers: median {data.p50_ms:.1f} ms, 99th percentile {data.p99_ms:.1f} ms.",
        ),
        [
            Table("Percentiles over all answers", [{"p50_ms": data.p50_ms, "p99_ms": data.p99_ms}]),
            Table("Latency of each answer", rows, _note(data)),
        ],
    )


def _note(data: ReplayData) -> str:
    stride = data.points.stride
    return f"Every {stride}th of {data.answers:,} answers is drawn and listed." if stride > 1 else ""
