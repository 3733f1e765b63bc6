"""What the answer would be without a class of objects, or without some objects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from semloc_core.cli.explained.lines import NAMED, head, line, place_of
from semloc_core.graph import short_id
from semloc_core.text import percent
from semloc_core.wire import Counterfactual, Explanation, MethodAttributions, PlaceMatches, WithoutClass

REMOVED_CLASSES = 6
"""Classes of removed objects that are named."""
SAME_PROBABILITY = 0.005
"""A probability nearer than this to the published one is no other answer."""


def would_change(explanation: Explanation, published: PlaceMatches) -> str:
    """The classes without which place, status or probability of an answer would be other ones."""
    without = explanation.without or []
    changing = [of for of in without if not _changes_nothing(of, published)]
    if changing:
        more = f"; and {len(changing) - NAMED} more" if len(changing) > NAMED else ""
        return "; ".join(_without([of], published) for of in changing[:NAMED]) + more
    if without:
        return f"no single class: without any one of {len(without)} it is {_answer(without, published)}"
    found = explanation.counterfactual
    if found is not None and found.removed:
        return f"without {_removed([(of.class_, of.id) for of in found.removed])}: {place_of(found.map, found.place)}"
    return "no removal that was tried changes it"


def print_what_if(
    order: Sequence[MethodAttributions],
    found: Counterfactual | None,
    without: Sequence[WithoutClass],
    published: PlaceMatches | None,
) -> None:
    """All that was tried.

    Args:
        order: of the explainers, first the one that is put to the test.
        found: the counterfactual by similarity.
        without: the answers without a class.
        published: the answer: classes that change nothing of it share a line; None: a line a class.

    """
    idle = [of for of in without if published is not None and _changes_nothing(of, published)]
    said = [_without([of], published) for of in without if of not in idle]
    said += [_without(idle, published)] if idle else []
    tested = [one for one in order if one.fidelity is not None and one.classes][:1]
    if tested and (fidelity := tested[0].fidelity) is not None:
        put = f"the {percent(fidelity.budget)} of the objects that {tested[0].method} puts first"
        said.append(f"without {put}")
        said.append(f"  the similarity, on a scale from 0 to 1, changes by {fidelity.necessity:.3f}")
        said.append(f"with them alone, by {fidelity.sufficiency:.3f}")
    if found is not None and found.removed:
        said.append(f"without {_removed([(item.class_, item.id) for item in found.removed])}")
        said.append(
            f"  the top match by similarity alone is {place_of(found.map, found.place)} ({found.similarity:.4f})"
        )
    elif found is not None:
        said.append("no removal of objects that was tried changes the top match by similarity")
    for number, text in enumerate(said):
        (line if number else lambda words: head("WHAT IF", words))(text)


def _changes_nothing(found: WithoutClass, published: PlaceMatches) -> bool:
    near = abs(found.probability - published.matches[0].probability) <= SAME_PROBABILITY
    return found.same and near and found.status in (None, published.status)


def _without(alike: Sequence[WithoutClass], published: PlaceMatches | None) -> str:
    """The answer without a class; or without any one of several that change nothing."""
    return f"had it seen {', or '.join(f'no {of.class_}' for of in alike)}: {_answer(alike, published)}"


def _answer(alike: Sequence[WithoutClass], published: PlaceMatches | None) -> str:
    """Status, place and probability, by similarity and layout."""
    found = alike[0]
    if found.map is None:
        return "unknown, nothing to go by"
    said = []
    if found.status is not None:
        same = published is not None and found.status == published.status
        other = f", no longer {_called(published.status)}" if published is not None and not same else ""
        said = [f"{'still ' if same else ''}{_called(found.status)}{other}"]
    values = sorted(f"{of.probability:.3f}" for of in alike)
    return ", ".join(
        [
            *said,
            "the same place" if found.same else place_of(found.map, found.place),
            f"probability {' to '.join(dict.fromkeys((values[0], values[-1])))}",
        ]
    )


def _called(status: str) -> str:
    return "a match" if status == "match" else status


def _removed(objects: list[tuple[str, str]]) -> str:
    """A few objects by name, many by number of each class, the most first."""
    if len(objects) <= 3:
        return ", ".join(f"{class_} {short_id(id_)}" for class_, id_ in objects)
    counts = Counter(class_ for class_, _ in objects)
    most = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    named = ", ".join(f"{count} × {class_}" for class_, count in most[:REMOVED_CLASSES])
    more = len(most) - REMOVED_CLASSES
    return f"{named} and {more} more" if more > 0 else named
