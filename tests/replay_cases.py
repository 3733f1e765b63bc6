"""Results bags made by hand: what each answer says, and where the robot truly was."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from small_building import CLASSES, building_update, make_map, make_model

from semloc_core import wire
from semloc_core.map_database import LoadedMap
from semloc_core.sources.bag import GROUND_TRUTH_TOPIC, BagWriter

STEP_NS = 500_000_000


@dataclass
class Step:
    """One answer: top matches as (building, x), the truth as (frame, x) or None, shares of classes or None."""

    matches: list[tuple[str, float]]
    truth: tuple[str, float] | None
    status: str = "match"
    shares: dict[str, float] | None = None
    latency_ms: float | None = None
    similarity: float = 0.9
    probability: float = 0.8


@dataclass
class Case:
    loaded: LoadedMap
    path: Path
    results: Path
    steps: list[Step] = field(default_factory=list)


def one_map(folder: Path, *names: str) -> tuple[LoadedMap, Path]:
    path = folder / "small.map"
    buildings = {name: building_update(seed=i) for i, name in enumerate(names or ("home",))}
    return make_map(path, make_model("rings"), **buildings), path


def write_results(
    path: Path, loaded: LoadedMap, steps: list[Step], *, truths: Path | None = None, truth_first: bool = False,
    map_hash: str | None = None,
) -> Path:  # fmt: skip
    """Write steps as the replay does; with ``truths`` the ground truth goes into a bag of its own."""
    with BagWriter(path) as bag, BagWriter(truths or path.with_name("unused.mcap")) as apart:
        for number, step in enumerate(steps):
            stamp = number * STEP_NS
            truth_bag = bag if truths is None else apart

            def write_truth(step: Step = step, stamp: int = stamp, truth_bag: BagWriter = truth_bag) -> None:
                if step.truth is not None:
                    truth_bag.write_point(GROUND_TRUTH_TOPIC, stamp, step.truth[0], (step.truth[1], 0.0, 0.0))

            if truth_first:
                write_truth()
            info = wire.MapInfo(loaded.name, map_hash or loaded.hash, loaded.n_places)
            bag.write_string("/localiser/matches", stamp, wire.encode(_matches(number, step, info)))
            if step.shares is not None:
                bag.write_string("/localiser/attributions", stamp, wire.encode(_attributions(number, step)))
            if not truth_first:
                write_truth()
    return path


def _matches(number: int, step: Step, info: wire.MapInfo) -> wire.PlaceMatches:
    return wire.PlaceMatches(
        schema="semloc/place_matches/1", stamp_ns=number * STEP_NS, frame_id="map", seq=number, query_place="q",
        status=step.status,
        matches=[
            wire.Match(i + 1, building, f"p{x:g}", (x, 0.0, 0.0), step.similarity, step.probability)
            for i, (building, x) in enumerate(step.matches)
        ],
        raw_matches=None, rivals=[], map=info, model=None, calibrated=False, latency_ms=step.latency_ms,
    )  # fmt: skip


def _attributions(number: int, step: Step) -> wire.ClassAttributions:
    assert step.shares is not None
    return wire.ClassAttributions(
        schema="semloc/class_attributions/1", stamp_ns=number * STEP_NS, frame_id="map", seq=number, query_place="q",
        match_map="home", match_place="p0", method="attention",
        classes=[
            wire.ClassAttribution(class_=c, score=s, share=s, instances=2)
            for c, s in sorted(step.shares.items(), key=lambda item: -item[1])
        ],
        objects=[], fidelity=None, completeness_gap=None,
    )  # fmt: skip


def walk() -> list[Step]:
    """Twelve answers along a corridor: right ones, wrong ones that fall on p25 and p26, one without a match."""
    steps = []
    for i in range(12):
        wrong = i in (3, 4, 5)
        at = (25.0 if i != 5 else 26.0) if wrong else float(i)
        shares = {CLASSES[0]: 0.75, CLASSES[1]: 0.25} if i % 2 == 0 else None
        steps.append(
            Step([("home", at)], ("home", float(i)), "ambiguous" if wrong else "match", shares, 2.0 + i, 0.5 + i / 40)
        )
    steps[8] = Step([], ("home", 8.0), "unknown")
    return steps
