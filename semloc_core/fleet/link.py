"""A robot's line to the server that keeps its map: what fails is not asked again at once, but ever more rarely."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from semloc_core.encoding import Model
from semloc_core.errors import MapError, MapUnavailableError
from semloc_core.fleet.object_votes import MappedObjects
from semloc_core.fleet.source import Catalogue, Fetched, MapSource

logger = logging.getLogger(__name__)

T = TypeVar("T")
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
JITTER = 0.2
"""Pauses differ by so much: robots that lost a server together do not come back together."""


class Link:
    """Asks a source, and remembers how that went. One thread asks; any may read.

    Args:
        source: the map; closed with the link.
        rng: draws the jitter.
        clock: seconds.
        sleep: waits for so many of them.

    Attributes:
        model: as last read; None before the first answer.
        catalogue: as last read.
        failure: why the last question failed; empty where it did not.
        since: when the first of the failures in a row was, by the clock.
        took_s: how long the last answer of the server took.
        outage_s: a question that the server does not answer is asked again, with the same pauses, until it has been
            silent for so long; 0 (a robot's): the question fails at once.

    """

    def __init__(
        self,
        source: MapSource,
        rng: np.random.Generator,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._source, self._rng, self._clock, self._sleep = source, rng, clock, sleep
        self.outage_s = 0.0
        self.model: Model | None = None
        self.catalogue: Catalogue | None = None
        self.failure = ""
        self.since = self.took_s = 0.0
        self._pauses, self._resume = 0, -np.inf
        self._users = 1

    @property
    def name(self) -> str:
        """The map's."""
        return self._source.name

    def shared(self) -> Link:
        """The same link, for one more user who will close it."""
        self._users += 1
        return self

    def close(self) -> None:
        """Close the source, if no other user is left."""
        self._users -= 1
        if not self._users:
            self._source.close()

    def pause_s(self) -> float:
        """Seconds until a question is asked again; 0 where the next one is."""
        return max(0.0, self._resume - self._clock())

    def lost_s(self) -> float:
        """For how many seconds nothing has been answered; 0 where the last question was."""
        return self._clock() - self.since if self.failure else 0.0

    def refresh(self) -> tuple[Model, Catalogue]:
        """The map as it is now.

        Raises:
            MapUnavailableError: the server does not answer, or is not asked because it lately did not.
            MapError: what it answers is no map, or damaged.

        """
        catalogue = self._ask(self._source.catalogue)
        if self.model is None or self.catalogue is None or catalogue.model_hash != self.catalogue.model_hash:
            self.model = self._ask(self._source.model)
        self.catalogue = catalogue
        return self.model, catalogue

    def similar(self, z: NDArray[np.float32], k: int, buildings: Collection[str] | None) -> Mapping[str, float] | None:
        """As `MapSource.similar`; None where the map lacks one of the buildings by now. Errors as of `refresh`."""
        return self._ask(lambda: self._unless_gone(lambda: self._source.similar(z, k, buildings), buildings or ()))

    def objects(self, buildings: Collection[str]) -> Mapping[str, MappedObjects] | None:
        """As `MapSource.objects`; None where the map lacks one of the buildings by now. Errors as of `refresh`."""
        return self._ask(lambda: self._unless_gone(lambda: self._source.objects(buildings), buildings))

    def fetch(self, building: str) -> Fetched | None:
        """As `MapSource.fetch`; None where the map lacks the building by now. Errors as of `refresh`."""
        return self._ask(lambda: self._unless_gone(lambda: self._source.fetch(building), (building,)))

    def _unless_gone(self, question: Callable[[], T], buildings: Collection[str]) -> T | None:
        try:
            return question()
        except MapUnavailableError:
            raise
        except MapError:
            if self._source.catalogue().buildings.keys() >= set(buildings):
                raise
            return None

    def _ask(self, question: Callable[[], T]) -> T:
        if not self.outage_s:
            return self._ask_once(question)
        while True:
            asked_before = bool(self.failure)
            try:
                return self._ask_once(question)
            except MapUnavailableError as error:
                left = self.outage_s - self.lost_s()
                if left <= 0:
                    raise MapUnavailableError(f"{self.failure}; nor to any question for {self.outage_s:g} s") from error
                if not asked_before:
                    logger.warning("waiting up to %.0f s for the map's server: %s", left, error)
            self._sleep(min(self.pause_s(), left))
            self._resume = -np.inf

    def _ask_once(self, question: Callable[[], T]) -> T:
        pause = self.pause_s()
        if pause > 0:
            raise MapUnavailableError(f"{self.failure} (asked again in {pause:.0f} s)")
        started = self._clock()
        try:
            answer = question()
        except MapError as error:
            self._failed(str(error), started)
            raise
        self.failure, self._pauses = "", 0
        self.took_s = self._clock() - started
        return answer

    def _failed(self, reason: str, started: float) -> None:
        if not self.failure:
            self.since = started
        pause = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2**self._pauses) * float(self._rng.uniform(1 - JITTER, 1 + JITTER))
        self.failure, self._resume = reason, self._clock() + pause
        self._pauses = min(self._pauses + 1, 10)
