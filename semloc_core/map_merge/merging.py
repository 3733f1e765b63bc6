"""A second traversal merges into a building: laid on it, compared with it, and what changed is taken over.

`merge` reads as that sentence does, a commented step a line. It changes nothing: what it returns is for the caller to
store (`semloc_core.map_merge.store`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_core.encoding import similarity_matrix
from semloc_core.errors import MapError
from semloc_core.graph import Floats, Ints, SceneGraph
from semloc_core.map_database import ClassChange, History, ObjectBelief, Traversal
from semloc_core.map_merge.align import Alignment, align, match_objects
from semloc_core.map_merge.config import MergeConfig
from semloc_core.map_merge.persistence import Observation, Verdict, judge
from semloc_core.map_merge.places import PlaceMatch, match_places
from semloc_core.map_merge.revise import revise
from semloc_core.map_merge.sides import Revision, Side
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class Merged:
    """What a building has become.

    Args:
        graph: its scene graph, in its own frame.
        history: what is believed of its objects and classes; this traversal is the last in it.
        alignment: how the traversal lies on it.

    """

    graph: SceneGraph
    history: History
    alignment: Alignment

    @property
    def traversal(self) -> Traversal:
        """What this traversal led to."""
        return self.history.traversals[-1]


def merge(
    mapped: Side,
    history: History,
    seen: Side,
    *,
    others: Sequence[Mapping[str, ClassChange]] = (),
    config: MergeConfig | None = None,
    source: str = "",
    name: str = "",
    run: str = "",
) -> Merged:
    """Merge a traversal into a building.

    Args:
        mapped: the building.
        history: what earlier traversals told of it.
        seen: the traversal, in any frame whose z axis is up; embedded by the map's model.
        others: class changes of the map's other buildings: a class is as mobile there as here.
        config: options.
        source: where the traversal came from, such as a file name.
        name: the building's, for errors.
        run: digest of the traversal's scene graph.

    Raises:
        MapError: how the traversal lies on the building is not supported by what it saw.

    """
    config = config or MergeConfig()
    # 1. Where it lies: places by their embeddings, objects by their class, distances decide.
    alignment = lay(mapped, seen, config, name)
    positions = alignment.transform.apply(seen.arrays.object_positions)
    # 2. Which places are one, which are new, and where the traversal saw free space.
    places = match_places(mapped.arrays, seen.arrays, alignment.transform.apply(seen.arrays.place_positions))
    # 3. What became of every object of the map.
    confirmed = confirmed_objects(mapped, seen, positions, alignment.gate_m)
    verdict, spare = _judged(mapped, history, seen, positions, confirmed, places, others, config, alignment.gate_m)
    # 4. The building as it is now.
    moved = np.array([[i, spare[j]] for i, j in enumerate(verdict.moved_to.tolist()) if j >= 0], dtype=np.int64)
    revision = revise(
        mapped, seen, history, alignment.transform, places, confirmed, moved.reshape(-1, 2).T, verdict, config
    )
    return Merged(revision.graph, _history(history, verdict, revision, alignment, source, run), alignment)


def lay(mapped: Side, seen: Side, config: MergeConfig, name: str = "") -> Alignment:
    """How a traversal lies on a building; errors as of `merge`."""
    for what, side in (("the building", mapped), ("the traversal", seen)):
        if not side.arrays.n_places or not side.arrays.n_objects:
            raise MapError(f"expected places and objects to lay {what} by (got none)")
    number = {each: i for i, each in enumerate(sorted({*mapped.names, *seen.names}))}
    similarity = similarity_matrix(seen.embeddings, mapped.embeddings)
    return align(mapped.scene(number), seen.scene(number), similarity, config, name)


def confirmed_objects(mapped: Side, seen: Side, positions: Floats, gate_m: float) -> Ints:
    """(2, K) objects of the map over objects of the traversal, at ``positions``, that are one."""
    number = {each: i for i, each in enumerate(sorted({*mapped.names, *seen.names}))}
    return match_objects(mapped.scene(number), seen.scene(number), positions, gate_m)[0]


def _judged(
    mapped: Side,
    history: History,
    seen: Side,
    positions: Floats,
    confirmed: Ints,
    places: PlaceMatch,
    others: Sequence[Mapping[str, ClassChange]],
    config: MergeConfig,
    gate_m: float,
) -> tuple[Verdict, Ints]:
    """The verdict, and (S,) the traversal's objects that are spare."""
    found = np.zeros(mapped.arrays.n_objects, dtype=np.bool_)
    found[confirmed[0]] = True
    expected = found.copy()
    child, parent = mapped.arrays.object_parents
    expected[child[places.covered[parent]]] = True
    spare = np.setdiff1d(np.arange(seen.arrays.n_objects), confirmed[1])
    unknown = ObjectBelief()
    observation = Observation(
        classes=mapped.names,
        beliefs=[history.objects.get(key, unknown) for key in mapped.arrays.object_ids],
        confirmed=found,
        expected=expected,
        positions=mapped.arrays.object_positions,
        spare=positions[spare],
        spare_classes=[seen.names[i] for i in spare.tolist()],
        area=mapped.area(places.covered),
    )
    return judge(observation, [history.classes, *others], config, gate_m), spare


def _history(
    history: History, verdict: Verdict, revision: Revision, alignment: Alignment, source: str, run: str
) -> History:
    """The history with this traversal in it."""
    classes = dict(history.classes)
    for name, change in verdict.changes.items():
        old = classes.get(name, ClassChange())
        classes[name] = ClassChange(old.stayed + change.stayed, old.moved + change.moved)
    traversal = Traversal(
        source=source,
        yaw=alignment.transform.yaw,
        translation=alignment.transform.translation,
        residual_m=alignment.residual_m,
        **revision.counts,
        run=run,
    )
    beliefs = {key: belief for key, belief in revision.beliefs.items() if belief != ObjectBelief()}
    return History((*history.traversals, traversal), beliefs, classes)
