"""Whether what one writer is about to write still fits what others have written since it read the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from semloc_core.errors import MapError
from semloc_core.fleet.milvus.reading import State
from semloc_core.map_database import ClassChange, PlaceRows, StoredBuilding, unpack_history
from semloc_core.text import short_repr


@short_repr
@dataclass(frozen=True)
class Draft:
    """A building that is to be written.

    Args:
        stored: it.
        places: its places.
        base: generation that it was made from, which must be the current one still when it is written; None: it
            takes the place of whatever is there.
        new: there must be no building of that name.

    """

    stored: StoredBuilding
    places: PlaceRows
    base: int | None = None
    new: bool = False


Changes = dict[str, Mapping[str, ClassChange]]


def check_unchanged(before: State, now: State, drafts: Mapping[str, Draft | None], *, rebuilt: bool) -> None:
    """Refuse to write over what another writer did meanwhile, where the drafts build on what was before.

    Args:
        before: what the drafts were made from.
        now: the map as it is.
        drafts: by building.
        rebuilt: whether the drafts are all of the map from now on, with a model of their own.

    Raises:
        MapError: a building is no longer what a draft was made from, or there is one already; the map has another
            model; what a class weighs has changed, or changes under buildings that the writer does not know.

    """
    if rebuilt or now.change == before.change:
        return
    was, is_now = before.map_row.model_hash[:12], now.map_row.model_hash[:12]
    if was != is_now:
        raise MapError(f"expected a map made with model {was} (got {is_now}: another writer built it anew meanwhile)")
    for building, draft in drafts.items():
        current = now.pointers.get(building)
        if draft is not None and draft.new and current is not None:
            raise MapError(f"expected a building that the map does not have (got {building!r})")
        if draft is not None and draft.base is not None and (current is None or current[0] != draft.base):
            advice = "which another writer changed meanwhile: try again"
            raise MapError(f"expected a building that is as it was read (got {building!r}, {advice})")
    if any(drafts.values()):
        _check_weights(before, now, drafts)


def _check_weights(before: State, now: State, drafts: Mapping[str, Draft | None]) -> None:
    """All embeddings of a map are made with what its classes weigh, which follows from all its histories."""
    advice = "another writer merged meanwhile: try again"
    if _changes(before, drafts) != _changes(now, drafts):
        raise MapError(f"expected classes that weigh what they did when the map was read (got others: {advice})")
    mine = {name: unpack_history(draft.stored.history).classes for name, draft in drafts.items() if draft is not None}
    taught = {name: pointer.changes for name, (_, pointer) in before.pointers.items() if name in drafts}
    strangers = sorted(now.pointers.keys() - before.pointers.keys() - drafts.keys())
    if strangers and _known(mine) != _known(taught):
        advice = "which another writer added meanwhile and which classes weigh more or less in now: try again"
        raise MapError(f"expected the buildings that were there (got {strangers[0]!r}, {advice})")


def _changes(state: State, drafts: Mapping[str, Draft | None]) -> Changes:
    """Class changes of the buildings that are not about to be written."""
    return _known({name: pointer.changes for name, (_, pointer) in state.pointers.items() if name not in drafts})


def _known(changes: Mapping[str, Mapping[str, ClassChange]]) -> Changes:
    return {name: by_class for name, by_class in changes.items() if by_class}
