"""Who says what of labels: the one place where a person's, a file's and a map's words come together.

Whoever says something of a label is heard in this order: the person (``--synonyms``, ``--labelspace``), the file (its
names), the map or model (its names, their synonyms, and its numbers for labels without a name). Every command, the
localiser, the bridge and the player read labels through a `Reading`, and say in a line what it had to decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

from semloc_core.graph.labels.classes import Labels
from semloc_core.graph.labels.cross_walk import CrossWalk
from semloc_core.graph.labels.files import load_labelspace, load_synonyms, shipped_labelspaces
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.names import folded
from semloc_core.graph.labels.union import union
from semloc_core.text import short_repr

if TYPE_CHECKING:
    from pathlib import Path

    from semloc_core.graph.scene_graph import SceneGraph

AUTO = "auto"
"""What stands in place of a synonym file for the shipped cross-walk of label sets."""


@short_repr
@dataclass(frozen=True)
class Reading:
    """What is said of labels, but for what the file itself says.

    Args:
        said: the labelspace that a person names.
        synonyms: what a person joins: a name, or ``class_7`` for number 7 -> a class.
        known: the labelspace of the map or model.
        topic, robot: which updates of a run are meant; None: what `semloc_core.sources.Run` finds by itself.
        shipped: ``said`` is one that semloc ships: it was not written for the file at hand. Its numbers overrule the
            file's names only where its numbering is the file's, as far as names that both have tell.
        auto: names that are not known are looked for in the cross-walk of label sets (`label_sets.yaml`).
        often: how often the map has each class. With it a name that may be any of several classes is read as all of
            them, by how often they are, and what is known of the detector's label set tells more; without, it is of no
            class.

    Raises:
        LabelspaceError: a synonym of a class that the map or model does not have.

    """

    said: Labelspace | None = None
    synonyms: Mapping[str, str] = field(default_factory=dict)
    known: Labelspace | None = None
    shipped: bool = False
    auto: bool = False
    often: Mapping[str, float] | None = None
    topic: str | None = None
    robot: str | None = None

    @classmethod
    def of(
        cls,
        labelspace: str | None,
        synonyms: str | Path | None,
        known: Labelspace | None = None,
        topic: str | None = None,
        robot: str | None = None,
    ) -> Reading:
        """What a person says by ``--labelspace``, ``--synonyms``, ``--topic`` and ``--robot``.

        Raises:
            LabelspaceError: no such labelspace, a file that is not right, or a synonym of a class that is not known.

        """
        said = load_labelspace(labelspace) if labelspace is not None else None
        auto = synonyms is not None and str(synonyms) == AUTO
        joined = load_synonyms(synonyms) if synonyms is not None and not auto else {}
        shipped = labelspace in shipped_labelspaces()
        found = cls(said, joined, shipped=shipped, auto=auto, topic=topic, robot=robot)
        return found if known is None else found.with_known(known)

    def with_known(self, known: Labelspace, often: Mapping[str, float] | None = None) -> Reading:
        """The same for a map or model of this labelspace, and for a map's own counts of its classes."""
        found = replace(self, known=known, often=often)
        _ = found.space  # a synonym of no class is refused at once
        return found

    @cached_property
    def space(self) -> Labelspace | None:
        """The labelspace of the map or model as it is after all that the person said; of the same hash."""
        space = self.known
        if space is not None and self.said is not None:
            if self.said.ids:
                space = space.with_ids_of(self.said)
            its = self.said.synonyms.items()
            space = space.with_synonyms({o: n for o, n in its if space.index(o) < 0 <= space.index(n)})
        return space.with_synonyms(self.synonyms) if space is not None else None

    def classes_of(self, files: Sequence[Labelspace]) -> Labelspace:
        """The classes to work in: the model's, those that the person names, else all that the files have.

        Args:
            files: each file's own labelspace.

        """
        if self.space is not None:
            return self.space
        if self.said is not None:
            return self.said.with_synonyms({o: n for o, n in self.synonyms.items() if self.said.index(n) >= 0})
        if not self.synonyms:
            return union(files)
        spelt = {folded(name): name for name in reversed(list(self.synonyms.values()))}
        own = Labelspace("synonyms", tuple(spelt.values()))
        return union([*files, own.with_synonyms(self.synonyms)])

    @cached_property
    def _walk(self) -> CrossWalk | None:
        return CrossWalk(self.space) if self.auto and self.space is not None else None

    @cached_property
    def _joined(self) -> dict[str, str]:
        return {folded(other): name for other, name in self.synonyms.items()}

    def labels(self, names: Mapping[int, str] | None = None) -> Labels:
        """A reader of one file's labels.

        Args:
            names: the file's own names of numbers, where it has any.

        """
        return Labels(self, names or {})


def read_graph(graph: SceneGraph, space: Labelspace) -> SceneGraph:
    """A graph by the names of a map's labelspace: for one that was written before its names were read."""
    return Reading(known=space).labels().graph(graph)
