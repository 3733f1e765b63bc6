"""The whole pipeline: a scene-graph update goes in, the place where the robot is and why comes out.

Read `Localiser.update` first. It composes three steps that can also be called apart, so that a node may answer
every query and explain only some: `apply` takes an update in, `locate` answers for the graph as it is,
`explain` says which classes carried an answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.encoding import LiveGraph, Query
from semloc_core.errors import ConfigError, MapError
from semloc_core.explain import answer_evidence, due, explain_answer
from semloc_core.graph import Outcome, Reading
from semloc_core.map_database import LoadedMap, frame_of, in_the_words_of
from semloc_core.matching import (
    Localisation,
    Located,
    RadiusIndex,
    Ranking,
    Reply,
    Reranked,
    Reranker,
    ServerState,
    Similarities,
    most_similar,
    verifier_of,
)
from semloc_core.text import short_repr
from semloc_core.tracking import FrameFilter, Hint, Hinted
from semloc_core.wire import (
    ClassAttributions,
    MapInfo,
    ModelInfo,
    Position,
    SceneGraphUpdate,
    decode_update,
)


@short_repr
@dataclass(eq=False)
class Localiser:
    """Localises one robot in one map. Not thread-safe, but what it returns may be read by any thread.

    Args:
        map: the loaded map database; it brings the encoder and the labelspace.
        config: options.
        said: what is said of the labels of updates; None: what the options say.

    Raises:
        ConfigError: options that exclude one another.
        LabelspaceError: no such labelspace or synonyms, or one of a class that the map does not have.

    Attributes:
        live: the robot's graph.
        map_info: what is published of the map; None while a server's map is not known yet.

    """

    map: LoadedMap
    config: LocaliserConfig = field(default_factory=LocaliserConfig)
    said: Reading | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.config.filter == "bayes" and self.config.rerank == "none":
            raise ConfigError("expected rerank layout with filter bayes, which weighs what was tested (got none)")
        self._said = self.said or Reading.of(self.config.labelspace or None, self.config.synonyms or None)
        self.live = LiveGraph(self.map.model)
        self._filter = FrameFilter() if self.config.filter == "bayes" else None
        self._answered: Located | None = None
        self._explained_ns: int | None = None
        self._hint: Hinted | None = None
        self._serve(self.map)
        self._read_labels()

    # -- the picture ---------------------------------------------------------------------------------------------

    def update(self, update: SceneGraphUpdate | bytes | str) -> Localisation:
        """Take an update, and answer.

        Args:
            update: the message, or its JSON text.

        Returns:
            The answer, with attributions where they are due by ``explain_rate_hz``.

        Raises:
            MessageError: the text is not a valid update; nothing changed.
            GraphError: the update does not fit the graph; nothing changed.

        """
        outcome = self.apply(update)
        if outcome is Outcome.REPEATED:
            return Localisation(outcome)
        located = self.locate()
        attributions = self.explain(located) if self.due(located) else None
        return Localisation(outcome, located, attributions, self.evidence(located))

    def apply(self, update: SceneGraphUpdate | bytes | str) -> Outcome:
        """Take an update into the graph, all or nothing (errors as of `update`)."""
        if not isinstance(update, SceneGraphUpdate):
            update = decode_update(update, self.config.max_update_bytes)
        outcome = self.live.apply(update)
        if outcome is not Outcome.REPEATED:
            self._answered = None
        if self._filter is not None and outcome is Outcome.APPLIED and self.live.stream.anew:
            self._filter.forget()
        return outcome

    def locate(self, place: str | None = None) -> Located:
        """Answer for the graph as it is now.

        Args:
            place: asked for instead of the query place.

        """
        located = self._locate(place, observed=place is None)
        if place is None:
            self._answered = located
        return located

    def _locate(self, place: str | None, observed: bool) -> Located:
        """Answer; the filter looks at what is observed, not at what is only asked about."""
        return self._answer(self.live.query(place, self.map), observed)

    def _answer(self, query: Query, observed: bool) -> Located:
        # 1. The place where the robot is, and what is around it, is an embedding.
        reply = Reply(query, self.map, self.config, self.map_info, self._model_info)
        if query.encoded is None or query.place is None or not self.map.n_places:
            return reply.nothing("no_graph" if self.live.graph is None or not reply.n_places else "unknown")
        # 2. Some places of the map are most similar to it.
        raw, similarity = most_similar(self.map, query.encoded.embedding[0].numpy(), self.config.top_n, self._index)
        # 3. The likeliest are put to the test: do objects lie around the robot as they do there?
        tested = self._test(query.place, similarity, raw, observed)
        # 4. So each is as likely as that, and this is what it rests on.
        return reply.answer(raw, similarity, self.live.stands(query.place), self._reranker, tested)

    def _test(self, place: str, similarity: Similarities, raw: Ranking, observed: bool) -> Reranked | None:
        """What the test by layout makes of the search's answer, and the filter of that, if they are asked for."""
        graph, ages, past = self.live.graph, self.live.ages, self._filter if observed else None
        if self._reranker is None or graph is None:
            return None
        robot, names = self.live.stands(place)[0], self.map.buildings
        return self._reranker.rank(
            graph,
            place,
            similarity,
            raw.rows,
            self.config.top_n,
            ages,
            only=None if self._hint is None else self._hint.allowed(self.map, ages.walked),
            robot=robot,
            past=None if past is None else lambda found: past.observe(found, names, robot, ages.walked, ages.drift),
        )

    def ask(self, place: str | None = None) -> Located:
        """The last answer where it is still that, else one for the graph as it is: a question is no observation.

        Args:
            place: asked about instead of the query place; of it alone, without what a filter knows.

        """
        last = self._answered
        if last is not None and place in (None, last.query.place):
            return last
        return self._locate(place, observed=False)

    def due(self, located: Located) -> bool:
        """Whether an explanation is due for this answer, by ``explain_rate_hz`` on message stamps."""
        asked = due(located, self.config, self._explained_ns)
        self._explained_ns = located.query.stamp_ns if asked else self._explained_ns
        return asked

    def explain(self, located: Located) -> ClassAttributions:
        """Say which classes and objects carried an answer, and how well that holds when put to the test.

        Reads nothing that later updates change.

        Raises:
            SemlocError: there is nothing to explain: the answer has no match.

        """
        return explain_answer(located, self.config)

    def evidence(self, located: Located) -> ClassAttributions | None:
        """Say what the decision rests on, exactly; None where nothing was put to the test."""
        return answer_evidence(located)

    # -- the map, and the robot's graph --------------------------------------------------------------------------

    def _serve(self, loaded: LoadedMap) -> None:
        """Answer from this map from now on; nothing is known of where the robot is in it."""
        self.map, whole = loaded, loaded.part_of or loaded
        self.map_info: MapInfo | None = MapInfo(name=loaded.name, hash=whole.hash, places=whole.n_places)
        self._model_info: ModelInfo | None = ModelInfo(name=loaded.model.encoder.name, hash=loaded.model.hash)
        self._index = RadiusIndex(loaded.positions, loaded.storey_index, MATCH_RADIUS_M)
        verifier = verifier_of(loaded) if self.config.rerank == "layout" else None
        if self._filter is not None and verifier is None and loaded.n_places:
            raise MapError(f"expected a map with scene graphs for filter bayes (got {loaded.name} without)")
        self._reranker = Reranker(loaded, verifier, self._index.within) if verifier is not None else None

    def _read_labels(self) -> None:
        """Read the graph, and what comes, in the map's words."""
        self.live.read_by(self.map.model, in_the_words_of(self.map, self._said).labels())

    @property
    def buildings(self) -> tuple[str, ...]:
        """Names of the buildings that an answer can be in."""
        return self.map.buildings

    def same_storey(self, building: str, place: str, position: Position) -> bool:
        """As of `LoadedMap.same_storey`, in the map as it is now."""
        return building in self.map.buildings and self.map.same_storey(building, place, position)

    def chance(self, building: str, position: Position) -> float:
        """As of `LoadedMap.chance`, of the places that an answer can name."""
        if building not in self.map.buildings:
            return 0.0
        part = self.map.part_of if self.config.buildings else None
        return self.map.chance(building, position) * (part.n_places / self.map.n_places if part is not None else 1.0)

    def frame_of(self, building: str | None) -> str:
        """Name of a building's frame; None: of an answer that is in none."""
        return frame_of(self.config.frame_id, self.map.all_buildings, building)

    def hint(self, hint: Hint | None) -> None:
        """Put only places near a hint to the test by layout, until the robot has walked on; None: all again."""
        self._hint = None if hint is None else Hinted(hint, self.live.ages.walked)

    def take_over(self, other: Localiser) -> None:
        """Go on with another localiser's stream, under this one's map and options: no update is missed.

        The other must not be used any more. What it knows of where the robot is goes on in the same map.
        """
        self.live, self._explained_ns = other.live, other._explained_ns
        self._read_labels()
        if other.map_info == self.map_info:
            self._hint = other._hint
            self._filter = other._filter if self.config.filter == other.config.filter else self._filter

    def renewed(self, config: LocaliserConfig | None = None) -> Localiser:
        """Another localiser on the same map, without this one's graph; ``buildings`` are as this map was opened."""
        return Localiser(self.map, config or self.config, self._said_by(config))

    def _said_by(self, config: LocaliserConfig | None) -> Reading | None:
        """What has been read already of what is said of labels; None where other options say something else."""
        mine = self.config
        same = config is None or (config.labelspace, config.synonyms) == (mine.labelspace, mine.synonyms)
        return self._said if same else None

    def keep_up(self) -> None:
        """Do what is to be done while nobody asks, too; nothing for a map in memory."""

    def server(self) -> ServerState | None:
        """How the map's server does; None for a map in memory. Any thread may ask."""
        return None

    def close(self) -> None:
        """Let go of the map; the localiser is not used any more."""
