"""The edges of a Hydra file, sorted out by what they connect."""

from __future__ import annotations

from collections import Counter

from semloc_core.sources.hydra.format import Document, Node


class Links:
    """The file's edges, sorted out by the kinds of their ends."""

    def __init__(self, document: Document, nodes: dict[int, Node], kind: dict[int, str], dropped: Counter[str]) -> None:
        self.traversability: list[tuple[str, str]] = []
        self.parents: list[tuple[str, str]] = []
        self.place_of_agent: dict[int, str] = {}
        self.places_of_room: dict[int, list[str]] = {}
        self.on_other_places: set[str] = set()
        self.reversed = 0
        seen: set[tuple[int, int]] = set()
        for edge in document.edges:
            a, b = edge.ends
            pair = (a, b) if a < b else (b, a)
            if a == b:
                dropped["self-loop"] += 1
            elif a not in nodes or b not in nodes:
                dropped["dangling edge"] += 1
            elif pair in seen:
                dropped["duplicate edge"] += 1
            else:
                seen.add(pair)
                self._add(a, b, kind)

    def _add(self, a: int, b: int, kind: dict[int, str]) -> None:
        ends = (kind.get(a), kind.get(b))
        if ends in (
            ("object", "place"),
            ("agent", "place"),
            ("place", "room"),
            ("object", "other place"),
        ):  # parents come first
            self.reversed += 1
            a, b, ends = b, a, ends[::-1]
        if ends == ("place", "place"):
            self.traversability.append((str(a), str(b)))
        elif ends == ("place", "object"):
            self.parents.append((str(a), str(b)))
        elif ends == ("other place", "object"):
            self.on_other_places.add(str(b))
        elif ends == ("place", "agent"):
            self.place_of_agent[b] = str(a)
        elif ends == ("room", "place"):
            self.places_of_room.setdefault(a, []).append(str(b))
