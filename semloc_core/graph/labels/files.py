"""Labelspaces and synonyms as YAML files: what is in one, strictly, and what it means."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from semloc_core.errors import LabelspaceError
from semloc_core.graph.labels.labelspace import Labelspace
from semloc_core.graph.labels.names import folded, placeholder

LARGEST_BYTES = 1 << 17
"""Some two thousand classes; a scene graph given by mistake is refused before a minute is spent on reading it."""
FOLDER = Path(str(resources.files("semloc_core.graph.labels"))) / "labelspaces"
LABEL_SETS = FOLDER.parent / "label_sets.yaml"

T = TypeVar("T")

logger = logging.getLogger(__name__)


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


def load_labelspace(name_or_path: str | Path) -> Labelspace:
    """A labelspace that semloc ships, by name, or one from a YAML file.

    Args:
        name_or_path: one of `shipped_labelspaces`, or the path of a file like these.

    Raises:
        LabelspaceError: neither, or the file is not right; names the file.

    """
    path = shipped_path(str(name_or_path))
    content = read_yaml(path, LabelspaceFile)
    try:
        whole = Labelspace(
            name=content.name,
            classes=tuple(row.name for row in content.classes),
            ids={row.name: tuple(row.ids) for row in content.classes if row.ids},
            mobility={row.name: row.mobility for row in content.classes if row.mobility is not None},
            synonyms={_spelt(other): name for other, name in content.synonyms.items()},
            default_mobility=content.default_mobility,
        )
        if both := whole.synonyms.keys() & set(whole.classes):
            raise LabelspaceError(f"expected synonyms that are not classes themselves (got {min(both)!r})")
        return _as_one(whole, str(path))
    except LabelspaceError as error:
        raise LabelspaceError(f"{error} ({path})") from None


def load_synonyms(path: str | Path) -> dict[str, str]:
    """A synonym file (YAML, ``synonyms: {a detector's name, or a number: a map's class}``).

    Raises:
        LabelspaceError: the file can't be read or is not right, or one name is joined to two classes.

    """
    found: dict[str, str] = {}
    meant: dict[str, str] = {}
    for other, name in read_yaml(path, SynonymsFile).synonyms.items():
        found[_spelt(other)] = name
        if folded(meant.setdefault(folded(_spelt(other)), name)) != folded(name):
            raise LabelspaceError(f"expected a synonym of one class (got {other!r} of several, in {path})")
    return found


def _spelt(other: str | int) -> str:
    return placeholder(other) if isinstance(other, int) else other


def _as_one(space: Labelspace, where: str) -> Labelspace:
    """The labelspace with names that are one name joined to the first of them, which is said."""
    together = Counter(folded(name) for name in space.classes)
    twice = [name for name in space.classes if together[folded(name)] > 1]
    if not twice:
        return space
    logger.warning("%s: class names that are one name become one class: %s", where, ", ".join(twice))
    first: dict[str, str] = {}
    ids: dict[str, tuple[int, ...]] = {}
    mobility: dict[str, float] = {}
    for name in space.classes:
        target = first.setdefault(folded(name), name)
        if name in space.ids:
            ids[target] = (*ids.get(target, ()), *space.ids[name])
        if name in space.mobility:
            mobility[target] = max(space.mobility[name], mobility.get(target, 0.0))
    synonyms = {other: first[folded(name)] for other, name in space.synonyms.items()}
    return replace(space, classes=tuple(first.values()), ids=ids, mobility=mobility, synonyms=synonyms)
