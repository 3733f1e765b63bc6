"""What is in a drawing: the SVG of a figure, parsed."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from matplotlib.figure import Figure

from semloc_core.report.drawing import to_svg


class Marks:
    def __init__(self, drawn: Figure | str) -> None:
        self.text = drawn if isinstance(drawn, str) else to_svg(drawn, "k", "a drawing")
        self.root = ET.fromstring(self.text)
        self.groups = {e.attrib["id"].removeprefix("k-"): e for e in self.root.iter() if "id" in e.attrib}

    def count(self, group: str) -> int:
        """Markers or shapes in the group; 0 where there is no such group."""
        if group not in self.groups:
            return 0
        inside = list(self.groups[group].iter())
        uses = sum(e.tag == "use" for e in inside)
        defined = {p for d in inside if d.tag == "defs" for p in d.iter()}
        return uses or sum(e.tag in ("path", "image") and e not in defined for e in inside)

    @property
    def labels(self) -> list[str]:
        return ["".join(e.itertext()).strip() for e in self.root.iter() if e.tag == "text"]
