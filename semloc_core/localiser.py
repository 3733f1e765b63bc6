"""The whole pipeline: a scene-graph update goes in, the place where the robot is and why comes out.

Read `Localiser.update` first. It composes three steps that can also be called apart, so that a node may answer
every query and explain only some: `apply` takes an update in, `locate` answers for the graph as it is,
`explain` says which classes carried an answer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semloc_core.config import MATCH_RADIUS_M, LocaliserConfig
from semloc_core.encoding import Surroundings
from semloc_core.explain import EXPLAINER_SEED, LAYOUT, answer_evidence, explain_answer
from semloc_core.graph import Ages, Labels, Outcome, UpdateStream, Visibility, all_unknown, lacks
from semloc_core.map_database import LoadedMap, frame_of
from semloc_core.matching import (
    CANDIDATES,
    IN_MAP,
    Localisation,
    Located,
    Placed,
    Query,
    RadiusIndex,
    Ranking,
    Reranked,
    Reranker,
    ServerState,
    matches_of,
    modes,
    place_probabilities,
    pose_in,
    transform_of,
    verifier_of,
)
from semloc_core.text import short_repr
from semloc_core.tracking import LASTS_M, Hint, MapModel, Tracker
from semloc_core.wire import (
    ClassAttributions,
    MapInfo,
    Match,
    ModelInfo,
    NameCounter,
    Object,
    Odometry,
    PlaceMatches,
    Position,
    SceneGraphUpdate,
    Status,
    Transform,
    decode_update,
    yaw_of,
)

__all__ = ["EXPLAINER_SEED", "Localisation", "Localiser", "Located", "Query"]


@short_repr
@dataclass(eq=False)
class Localiser:
    """Localises one robot in one map. Not thread-safe, but what it returns may be read by any thread.

    Args:
        map: the loaded map database; it brings the encoder and the labelspace.
        config: options.

    Attributes:
        labels: reads the updates' labels, where a person said something of them; None leaves them to the map.
        unknown_classes: names of object classes that the labelspace lacks -> different objects seen of them.
        map_info: what is published of the map; None while a server's map is not known yet.

    """

    map: LoadedMap
    config: LocaliserConfig = field(default_factory=LocaliserConfig)
    unknown_classes: NameCounter = field(default_factory=NameCounter)

    def __post_init__(self) -> None:
        self.stream = UpdateStream()
        self.labels: Labels | None = None
        self._seq, self._stamp_ns = 0, 0
        self._explained_ns: int | None = None
        self._surroundings: Surroundings | None = None
        self._answered: Located | None = None
        self._odometry: Odometry | None = None
        self._frame_id = ""
        self._ages = Ages()
        self._hint: tuple[Hint, float] | None = None
        self._serve(self.map)

    def _serve(self, loaded: LoadedMap, filter_model: MapModel | None = None) -> None:
        """Answer from this map from now on; nothing is known of where the robot is in it."""
        self.map, whole = loaded, loaded.part_of
        self.map_info: MapInfo | None = MapInfo(
            name=loaded.name,
            hash=loaded.hash if whole is None else whole.hash,
            places=loaded.n_places if whole is None else whole.n_places,
        )
        self._model_info: ModelInfo | None = ModelInfo(name=loaded.model.encoder.name, hash=loaded.model.hash)
        self._index = RadiusIndex(loaded.positions, loaded.storey_index, MATCH_RADIUS_M)
        verifier = verifier_of(loaded) if self.config.rerank == "layout" else None
        self._reranker = Reranker(loaded, verifier, self._index.within) if verifier is not None else None
        tracked = self.config.filter == "bayes" and loaded.n_places
        self._tracker = Tracker(loaded, model=filter_model) if tracked else None

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

    def renewed(self, config: LocaliserConfig | None = None) -> Localiser:
        """Another localiser on the same map, without this one's stream; ``buildings`` are as this map was opened."""
        return Localiser(self.map, config or self.config)

    def keep_up(self) -> None:
        """Do what is to be done while nobody asks, too; nothing for a map in memory."""

    def frame_of(self, building: str | None) -> str:
        """Name of a building's frame; None: of an answer that is in none."""
        return frame_of(self.config.frame_id, self.map.all_buildings, building)

    def hint(self, hint: Hint | None) -> None:
        """Put only places near a hint to the test by layout, until the robot has walked on; None: all again.

        What the search by similarity proposes besides, and a filter's belief, stay as they are.
        """
        self._hint = None if hint is None else (hint, self._ages.walked)

    @property
    def odometry(self) -> Odometry | None:
        """Of the latest update."""
        return self._odometry

    def server(self) -> ServerState | None:
        """How the map's server does; None for a map in memory. Any thread may ask."""
        return None

    def close(self) -> None:
        """Let go of the map; the localiser is not used any more."""

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

    def take_over(self, other: Localiser) -> None:
        """Go on with another localiser's stream, under this one's map and options: no update is missed.

        The other must not be used any more.
        """
        self.stream, self._seq, self._stamp_ns = other.stream, other._seq, other._stamp_ns
        self._explained_ns, self._odometry, self.labels = other._explained_ns, other._odometry, other.labels
        self._frame_id, self._ages = other._frame_id, other._ages
        if other.map.hash == self.map.hash:
            self._hint = other._hint
        if self._tracker is not None and other._tracker is not None and other.map.hash == self.map.hash:
            self._tracker = other._tracker
        self._look_again(other._visibility)

    def _look_again(self, visibility: Visibility | None) -> None:
        """Look at the graph as the map's model does; ``visibility`` by another model is kept if that looks as far."""
        graph, model = self.stream.graph, self.map.model
        self._surroundings = None
        self.unknown_classes.clear()
        if graph is None:
            return
        extraction = model.encoder.extraction
        kept = visibility if visibility is not None and visibility.radius_m == extraction.visibility_m else None
        self._surroundings = Surroundings(graph, model.labelspace, extraction, kept)
        self._count_unknown(graph.objects.values())

    def _count_unknown(self, objects: Iterable[Object]) -> None:
        space = self.map.model.labelspace
        for item in objects:
            if lacks(space, item.class_):
                self.unknown_classes.see(item.class_, item.id)

    # -- 1. the update into the graph -----------------------------------------------------------------------

    @property
    def _visibility(self) -> Visibility | None:
        """Of the graph as it is now."""
        return None if self._surroundings is None else self._surroundings.visibility

    def apply(self, update: SceneGraphUpdate | bytes | str) -> Outcome:
        """Take an update into the graph, all or nothing (errors as of `update`)."""
        if not isinstance(update, SceneGraphUpdate):
            update = decode_update(update, self.config.max_update_bytes)
        if self.labels is not None:
            update = self.labels.update(update)
        outcome, change = self.stream.apply(update)
        if outcome is Outcome.REPEATED:
            return outcome
        self._answered = None
        self._seq, self._stamp_ns = update.seq, update.stamp_ns
        self._odometry, self._frame_id = update.odometry, update.frame_id
        graph = self.stream.graph
        if graph is not None and change is not None:
            self._ages.update(graph, change, update.odometry)
        if graph is None:
            self._surroundings = None
        elif self._surroundings is None or self._surroundings.graph is not graph:
            model = self.map.model
            self._surroundings = Surroundings(graph, model.labelspace, model.encoder.extraction)
        elif change is not None:
            self._surroundings.update(change)
        if outcome is Outcome.APPLIED:
            self._count_unknown(update.objects)
        return outcome

    # -- 2. the query place, embedded and looked up ---------------------------------------------------------

    def locate(self, place: str | None = None) -> Located:
        """Answer for the graph as it is now.

        Args:
            place: asked for instead of the query place.

        """
        located = self._locate(place)
        if place is None:
            self._answered = located
        return located

    def ask(self, place: str | None = None) -> Located:
        """The last answer where it is still that, else one for the graph as it is: a question is no observation.

        Args:
            place: asked about instead of the query place; of it alone, without what a filter knows.

        """
        last = self._answered
        if last is not None and place in (None, last.query.place):
            return last
        graph = self.stream.graph
        return self._locate(place or (graph.query_place if graph is not None else None))

    def _locate(self, place: str | None) -> Located:
        return self._answer(self._embed(place), observed=place is None)

    def _answer(self, query: Query, observed: bool) -> Located:
        """Answer an embedded query; what was observed, not only asked about, is taken in by the filter."""
        if query.encoded is None or not self.map.n_places:
            if observed:
                self._track(query, np.zeros(self.map.n_places, dtype=np.float32))
            mapped = self.map_info is not None and self.map_info.places
            status: Status = "unknown" if self.stream.graph is not None and mapped else "no_graph"
            return Located(query, self._message(query, status), self.map)
        z = query.encoded.embedding[0].numpy()
        raw, everywhere = self._search(z)
        tested = self._test(query, everywhere, raw)
        believed = self._track(query, everywhere, tested) if observed else None
        calibrated = believed is None and self._reranker is not None
        if believed is not None:
            ranking = believed
        elif tested is not None:
            ranking = tested.ranking
        else:
            ranking = raw if self._reranker is None else raw.doubted()
        best = int(ranking.rows[0])
        accepted = ranking.probability[best] >= self.config.accept_probability
        rivals = ranking.rivals()[: 0 if accepted else self.config.top_n]
        places = self._placed(tested, np.concatenate([ranking.rows, rivals]), believed is not None)
        poses = {row: pose_in(place, *self._stands(query)) for row, place in places.items()}
        message = self._message(
            query,
            "match" if accepted else "ambiguous" if ranking.in_map >= IN_MAP else "unknown",
            matches=matches_of(self.map, ranking.rows, ranking, everywhere, poses),
            rivals=matches_of(self.map, rivals, ranking, everywhere, poses),
            raw_matches=matches_of(self.map, raw.rows, raw, everywhere) if ranking is not raw else None,
            calibrated=calibrated,
            transform=transform_of(places[best]) if best in places else None,
        )
        evidence = self._reranker.evidence(tested, best) if self._reranker is not None and tested is not None else None
        return Located(query, message, self.map, best, evidence)

    def _search(self, z: NDArray[np.float32]) -> tuple[Ranking, NDArray[np.float32]]:
        """The places most similar to an embedding (D,); (M,) similarities to all places."""
        rows, _, everywhere = self.map.index.everywhere(z, max(CANDIDATES, self.config.top_n))
        shown = rows[: self.config.top_n]
        separate = np.array(modes(rows, self._index.within), dtype=np.int64)
        asked = np.concatenate([shown, separate])
        chances = place_probabilities(everywhere, self.map.model.temperature, asked, self._index.within)
        return Ranking(shown, separate, dict(zip(asked.tolist(), chances.tolist(), strict=True))), everywhere

    def _test(self, query: Query, everywhere: NDArray[np.float32], raw: Ranking) -> Reranked | None:
        """What verification by layout makes of the search's answer, if it is asked for."""
        graph = self.stream.graph
        if self._reranker is None or graph is None or query.place is None:
            return None
        only, robot = self._hinted(), self._stands(query)[0]
        return self._reranker.rank(graph, query.place, everywhere, raw.rows, self.config.top_n, self._ages, only, robot)

    def _hinted(self) -> NDArray[np.bool_] | None:
        """(M,) bool, where the robot can be by what somebody said; None: anywhere."""
        if self._hint is None:
            return None
        hint, walked = self._hint
        since = self._ages.walked - walked
        if since > LASTS_M:
            self._hint = None
            return None
        allowed = hint.allows(self.map, since)
        return allowed if allowed.any() else None

    def _placed(self, tested: Reranked | None, rows: NDArray[np.int64], filtered: bool) -> Mapping[int, Placed]:
        """Where the frame of the updates lies in the buildings of rows of the map, as far as these were tested."""
        if self._reranker is None or tested is None:
            return {}
        return self._reranker.placed(tested, rows.tolist(), near=filtered)

    def _stands(self, query: Query) -> tuple[NDArray[np.float64], float | None]:
        """(3,) where the robot is in the frame of the updates, metres, and its heading there where that is known."""
        odometry, graph = self._odometry, self.stream.graph
        assert graph is not None
        assert query.place is not None
        asked = query.place == graph.query_place
        if odometry is None or odometry.frame_id != self._frame_id or not asked:
            return np.array(graph.places[query.place]), None
        return np.array(odometry.position), yaw_of(odometry.orientation_xyzw)

    def _track(self, query: Query, everywhere: NDArray[np.float32], tested: Reranked | None = None) -> Ranking | None:
        """What the filter makes of it, if there is one: also of a place with nothing around it."""
        graph = self.stream.graph
        if self._tracker is None or graph is None or query.place not in graph.places:
            return None
        if tested is None:
            in_map = 1.0 if self._reranker is None else None
            self._tracker.observe(graph, query.place, everywhere, self._odometry, in_map=in_map)
        else:
            in_map = tested.ranking.in_map
            self._tracker.observe(graph, query.place, everywhere, self._odometry, tested.verified, in_map)
        return self._tracker.ranking(self.config.top_n)

    def _embed(self, place: str | None) -> Query:
        """Find the query place, extract its surroundings, encode them."""
        graph = self.stream.graph
        if place is None and graph is not None:
            place = graph.query_place
        query = Query(self._stamp_ns, self._seq, place)
        if graph is None or self._surroundings is None:
            return query
        if place is None:
            return query.because("no query place")
        if place not in graph.places:
            return query.because("the place asked for is not in the graph")
        if not graph.neighbours[place]:
            return query.because("the query place is isolated")
        batch = self.map.weigh(self._surroundings.batch(place))
        if not bool(batch.is_object.any()):
            why = all_unknown((item.class_ for item in graph.objects.values()), self.map.model.labelspace)
            return query.because(why or "no object in reach of the query place")
        encoded = self.map.queries.encode(batch)
        if not bool(encoded.embedding.any()):
            return query.because("the encoder has nothing to say of this place")
        name = self.map.model.labelspace.canonical
        names = tuple(
            name(graph.objects[node].class_) if is_object else ""
            for node, is_object in zip(batch.node_ids, batch.is_object.tolist(), strict=True)
        )
        return Query(query.stamp_ns, query.seq, place, batch, encoded, names)

    # -- 3. why ------------------------------------------------------------------------------------------------

    def due(self, located: Located) -> bool:
        """Whether an explanation is due for this answer, by ``explain_rate_hz`` on message stamps."""
        rate = self.config.explain_rate_hz
        if located.best_row is None or rate <= 0:
            return False
        if self.config.explainer == LAYOUT and located.evidence is None:
            return False  # the place was not put to the test that is to be explained
        now, last = located.query.stamp_ns, self._explained_ns
        # Half a millisecond of grace: stamps of a steady stream jitter by rounding.
        if last is not None and last <= now < last + 1e9 / rate - 5e5:
            return False
        self._explained_ns = now
        return True

    def evidence(self, located: Located) -> ClassAttributions | None:
        """Say what the decision rests on, exactly; None where nothing was put to the test."""
        return answer_evidence(located)

    def explain(self, located: Located) -> ClassAttributions:
        """Say which classes and objects carried an answer, and how well that holds when put to the test.

        Reads nothing that later updates change.

        Raises:
            SemlocError: there is nothing to explain: the answer has no match.

        """
        return explain_answer(located, self.config)

    # -- messages ----------------------------------------------------------------------------------------------

    def _message(
        self,
        query: Query,
        status: Status,
        matches: list[Match] | None = None,
        rivals: list[Match] | None = None,
        raw_matches: list[Match] | None = None,
        calibrated: bool = False,
        transform: Transform | None = None,
    ) -> PlaceMatches:
        return PlaceMatches(
            schema="semloc/place_matches/1",
            stamp_ns=query.stamp_ns,
            frame_id=self.frame_of(matches[0].map if matches else None),
            seq=query.seq,
            query_place=query.place,
            status=status,
            matches=matches or [],
            raw_matches=raw_matches,
            rivals=rivals or [],
            map=self.map_info,
            model=self._model_info,
            calibrated=calibrated,
            latency_ms=None,
            transform=transform,
        )
