# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""What a person is told about the node, and can act on. No ROS here."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from semloc_core.explain import ClassShift, Shift
from semloc_core.graph import all_numbers
from semloc_core.wire import PlaceMatches
from semloc_ros.explaining import ExplainCounts
from semloc_ros.worker import Answer, Worker

Level = Literal["ok", "warn", "error", "stale"]
WINDOW = 1000
"""Latencies and times kept: the latest."""
RATE_WINDOW_S = 5.0
LISTED = 100
"""Buildings named at most."""


@dataclass(frozen=True)
class Line:
    """One status: ``name`` of what it is about, how bad, one sentence, and figures."""

    name: str
    level: Level
    message: str
    values: dict[str, str] = field(default_factory=dict)


class Rate:
    """How often something happens, over the last seconds by the steady clock. Any thread may use it."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=WINDOW)

    def tick(self) -> None:
        """It has happened."""
        self._times.append(time.monotonic())

    def hz(self) -> float:
        """Events per second."""
        since = time.monotonic() - RATE_WINDOW_S
        recent = [t for t in list(self._times) if t >= since]
        # A full buffer spans less than the window: then its own span counts.
        span = time.monotonic() - recent[0] if len(recent) == WINDOW else RATE_WINDOW_S
        return len(recent) / max(span, 1e-9)


class Diagnostics:
    """Watches answers and says how things are."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latency_ms: deque[float] = deque(maxlen=WINDOW)
        self._answers = Rate()
        self._last: Answer | None = None

    def answered(self, answer: Answer, latency_ms: float) -> None:
        """Take in an answer that has just been published."""
        with self._lock:
            self._latency_ms.append(latency_ms)
            self._last = answer
        self._answers.tick()

    def lines(
        self,
        worker: Worker,
        explained: ExplainCounts,
        shift: ClassShift | None,
        state: str,
        stale_after_s: float,
        failure: str = "",
    ) -> list[Line]:
        """How things are now: in this state of the lifecycle, whose last transition failed so."""
        with self._lock:
            last, latencies = self._last, list(self._latency_ms)
        level, message = _localisation(worker, last, state, stale_after_s)
        if failure:
            level, message = "error", f"{state}: {failure}"
        counts, stream = worker.counts, worker.stream_counts()
        matches = last.located.matches if last is not None else None
        values = {
            "state": state,
            "status": matches.status if matches is not None else "none",
            "updates received": str(counts.received),
            "updates applied": str(stream["applied"]),
            "updates missed (their numbers were skipped)": str(counts.missed),
            "updates rejected": str(counts.malformed + stream["rejected"]),
            "updates repeated": str(stream["repeated"]),
            "gaps in the stream": str(stream["gap"]),
            "updates without a graph": str(stream["waiting"]),
            "last rejection": counts.last_rejection or "none",
            "answers": str(counts.answered),
            "updates not answered (fell behind)": str(counts.skipped),
            "answers per second": f"{self._answers.hz():.1f}",
            "explanations": str(explained.published),
            "explanations late (attention instead)": str(explained.late),
            "explanations skipped": str(explained.skipped),
        }
        for percent in (50, 90, 99):
            found = f"{np.percentile(latencies, percent):.1f}" if latencies else "none"
            values[f"latency p{percent} (ms)"] = found
        updates = _updates_line(worker, stale_after_s)
        lines = [Line("localisation", level, message, values), updates, _map_line(worker), _shift_line(shift, matches)]
        server = worker.localiser.server()
        if server is not None:
            lines.append(Line("map server", "ok" if server.answers else "error", server.line, server.values))
        return lines


def not_running(state: str, failure: str) -> Line:
    """What is said of a node that has no localiser: in which state, and why, where its last transition failed."""
    if failure:
        return Line("localisation", "error", f"{state}: {failure}", {"state": state})
    if state == "configuring":
        return Line("localisation", "ok", "configuring: the map is being loaded", {"state": state})
    if state == "unconfigured":
        return Line("localisation", "warn", "unconfigured: waits for a lifecycle manager", {"state": state})
    return Line("localisation", "warn", f"{state}: nothing is answered", {"state": state})


def _localisation(worker: Worker, last: Answer | None, state: str, stale_after_s: float) -> tuple[Level, str]:
    if state != "active":
        return "ok", f"{state}: updates are applied, nothing is answered"
    level, message = _input(worker, stale_after_s)
    if level in ("stale", "error"):
        return level, message
    if worker.answered_ns is not None and _age_s(worker.answered_ns) > stale_after_s:
        return "error", f"updates are applied, but none was answered for {_age_s(worker.answered_ns):.0f} s"
    if last is None:
        return "warn", "updates come, and the first answer is awaited"
    matches = last.located.matches
    if matches.status == "no_graph" and last.located.query.reason:
        return "error", f"no map: {last.located.query.reason}"
    if matches.status == "no_graph":
        return "error", "no graph: updates were missed, and no full update has come since"
    if matches.status == "unknown" and not matches.matches:
        return "warn", f"unknown: {last.located.query.reason or 'nothing to go by'}"
    best = matches.matches[0]
    where = f"{best.map} ({', '.join(f'{x:.1f}' for x in best.position)}), probability {best.probability:.2f}"
    if matches.status == "unknown":
        return "warn", f"unknown: probably in no building of the map; the best of it is {where}"
    if matches.status == "ambiguous":
        rivals = [f"{r.map} ({', '.join(f'{x:.1f}' for x in r.position)})" for r in matches.rivals[:3]]
        return "warn", f"ambiguous: {where}" + (f", or {', or '.join(rivals)}" if rivals else "")
    return "ok", f"localised: {where}"


def _age_s(since_ns: int | None) -> float:
    return (time.monotonic_ns() - since_ns) / 1e9 if since_ns is not None else math.inf


def _input(worker: Worker, stale_after_s: float) -> tuple[Level, str]:
    """What becomes of the updates."""
    if worker.updated_ns is None:
        return "stale", "no update has come yet: is anything published on scene_graph?"
    age_s = _age_s(worker.updated_ns)
    if age_s > stale_after_s:
        return "stale", f"stale input: no update for {age_s:.0f} s"
    recent = [(ns, kind) for ns, kind in list(worker.losses) if _age_s(ns) < max(RATE_WINDOW_S, stale_after_s)]
    losses = Counter(kind for _, kind in recent)
    lost = ", ".join(f"{count} {kind}" for kind, count in sorted(losses.items()))
    last = worker.counts.last_rejection
    lost += f" (the last one: {last})" if last and losses.keys() & {"malformed", "rejected"} else ""
    lost += "; a mapper that starts again must begin with a full update" if losses["repeated"] else ""
    age_s = _age_s(worker.applied_ns)
    if any(kind in ("gap", "waiting") and _age_s(ns) < age_s for ns, kind in recent):
        return "error", f"no graph: updates were missed, and no full update has come since: {lost}"
    if lost and age_s > stale_after_s:
        since = f"for {age_s:.0f} s" if worker.applied_ns is not None else "yet"
        return "error", f"updates come, but none could be applied {since}: {lost}"
    return ("warn", f"updates are lost: {lost}") if lost else ("ok", "every update is applied")


def _updates_line(worker: Worker, stale_after_s: float) -> Line:
    level, message = _input(worker, stale_after_s)
    return Line("updates", level, message)


def _map_line(worker: Worker) -> Line:
    localiser = worker.localiser
    loaded, info, unknown = localiser.map, localiser.map_info, dict(localiser.live.unknown_classes)
    if info is None:
        return Line("map", "error", f"map {loaded.name} is not known yet: its server has not answered", {})
    model, buildings = loaded.model, localiser.buildings
    values = {
        "map": info.name,
        "map hash": info.hash,
        "places": str(info.places),
        "buildings": ", ".join(buildings[:LISTED]) + (", …" if len(buildings) > LISTED else ""),
        "model": model.encoder.name,
        "model hash": model.hash,
        "labelspace": model.labelspace.name,
        "labelspace hash": model.labelspace.hash,
    }
    if not info.places:
        return Line("map", "error", f"map {info.name} has no places", values)
    text = f"map {info.name} {info.hash[:12]}: {info.places} places"
    text += "" if localiser.config.buildings else f" in {len(buildings)} buildings"
    text += f", of which {len(buildings)} buildings are asked" if localiser.config.buildings else ""
    if unknown:
        listed = ", ".join(f"{name} ({count})" for name, count in sorted(unknown.items()))
        values["classes that the labelspace lacks"] = listed
        helps = "; the bridge's parameter labelspace names numbers" if all_numbers(unknown) else ""
        return Line("map", "warn", f"{text}; objects of classes it lacks are not used: {listed}{helps}", values)
    return Line("map", "ok", text, values)


def _shift_line(shift: ClassShift | None, matches: PlaceMatches | None) -> Line:
    name = "lost or changed?"
    if shift is None:
        return Line(name, "ok", "not looked at yet")
    objects, attributions = shift.objects(), shift.attributions()
    if objects is None:
        return Line(name, "ok", "too few answers yet to compare with the map")
    values = {"building": objects.building} | _shift_values("classes", objects)
    if attributions is not None:
        values |= _shift_values("attributions", attributions)
    strange = [kind for kind in (objects, attributions) if kind is not None and kind.distance > kind.usual]
    if not strange:
        return Line(
            name, "ok", f"as in the map: class mix {objects.distance:.2f} away ({objects.usual:.2f} is usual)", values
        )
    worst = max(strange, key=lambda kind: kind.distance - kind.usual)
    what = "the class mix" if worst is objects else "what matches rest on"
    sure = matches is not None and matches.status == "match"
    verdict = "changed? The robot is localised, but" if sure else "lost? The robot is not localised, and"
    return Line(name, "warn", f"{verdict} {what} is not the map's: {worst.describe()}", values)


def _shift_values(kind: str, shift: Shift) -> dict[str, str]:
    return {
        f"{kind}: distance from the map": f"{shift.distance:.3f}",
        f"{kind}: usual within the map": f"{shift.usual:.3f}",
        f"{kind}: responsible": shift.describe(),
    }
