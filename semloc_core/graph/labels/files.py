"""Labelspaces and synonyms as YAML files: what is in one, strictly; `labels.labelspace` gives it meaning."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from semloc_core.errors import LabelspaceError

LARGEST_BYTES = 1 << 17
"""Some two thousand classes; a scene graph given by mistake is refused before a minute is spent on reading it."""
FOLDER = Path(str(resources.files("semloc_core.graph.labels"))) / "labelspaces"
LABEL_SETS = FOLDER.parent / "label_sets.yaml"

T = TypeVar("T")


class ClassRow(msgspec.Struct, forbid_unknown_fields=True):
    """One class: its name, its labels in a Hydra file, its mobility in metres."""

    name: str
    ids: list[int] = []
    mobility: float | None = None


class LabelspaceFile(msgspec.Struct, forbid_unknown_fields=True):
    """A labelspace file."""

    name: str
    classes: list[ClassRow]
    synonyms: dict[str | int, str] = {}
    default_mobility: float = 0.1


class SynonymsFile(msgspec.Struct, forbid_unknown_fields=True):
    """A synonym file."""

    synonyms: dict[str | int, str]


class _Loader(yaml.SafeLoader):
    """YAML in which no key may stand twice: the later one would win in silence."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            keys = [str(key.value) for key, _ in node.value]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise yaml.constructor.ConstructorError(problem=f"key {twice!r} stands twice")
        return mapping


def shipped_labelspaces() -> tuple[str, ...]:
    """The names of the labelspaces that semloc ships."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def shipped_path(name_or_path: str) -> Path:
    """The file of a shipped labelspace, or the path itself."""
    if name_or_path in shipped_labelspaces():
        return FOLDER / f"{name_or_path}.yaml"
    path = Path(name_or_path)
    if not path.is_file():
        names = ", ".join(shipped_labelspaces())
        raise LabelspaceError(f"expected a labelspace file or one of {names} (got {name_or_path!r})")
    return path


def read_yaml(path: str | Path, type_: type[T]) -> T:
    """Read a `LabelspaceFile` or a `SynonymsFile`.

    Raises:
        LabelspaceError: it can't be read, is not YAML, or holds something else.

    """
    what = f"expected a YAML file of {'synonyms' if type_ is SynonymsFile else 'a labelspace'} at {path}"
    try:
        with Path(path).open(encoding="utf-8") as file:
            text = file.read(LARGEST_BYTES + 1)
        if len(text) > LARGEST_BYTES:
            raise LabelspaceError(f"{what} (got more than {LARGEST_BYTES >> 10} kB)")
        return msgspec.convert(yaml.load(text, _Loader), type_)
    except OSError as error:
        raise LabelspaceError(f"{what} (got: {error.strerror})") from error
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:  # so msgspec's and Unicode's
        raise LabelspaceError(f"{what} (got: {' '.join(str(error).split())})") from error
