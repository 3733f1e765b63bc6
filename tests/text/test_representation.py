"""Representations stay short: a debugger or a log that shows a localiser would otherwise print its whole map."""

import dataclasses
import importlib
import pkgutil
import re
from collections import deque

import msgspec
import numpy as np
import pytest
import torch
from small_building import building_update, make_map, make_model

import semloc_core
from semloc_core.encoding.encoder import build_encoder
from semloc_core.localiser import Localiser
from semloc_core.map_database.history import History
from semloc_core.text.representation import MAX_REPR
from semloc_core.wire import messages
from semloc_core.wire.name_counter import NameCounter

SMALL = re.compile(
    r"(int|float|str|bool|Path|Outcome|Status|Position|Point|Size|Axis|Literal\[.*\]|Callable\[.*\]|"
    r"tuple\[(int|float|str)(, (int|float|str))*\])( \| None)?"
)
"""Annotations of what is never long."""
BIG = (np.zeros((300, 300)), ["a name of a class"] * 5000, {str(i): i for i in range(5000)}, "x" * 5000)


def holders() -> list[type]:
    """Public dataclasses and named tuples of every module."""
    found = {}
    for module in pkgutil.walk_packages(semloc_core.__path__, "semloc_core."):
        if module.name.endswith("__main__"):
            continue
        for name, cls in vars(importlib.import_module(module.name)).items():
            own = isinstance(cls, type) and cls.__module__ == module.name and not name.startswith("_")
            if own and (dataclasses.is_dataclass(cls) or (issubclass(cls, tuple) and hasattr(cls, "_fields"))):
                found[f"{module.name}.{name}"] = cls
    return [found[name] for name in sorted(found)]


def filled(cls: type, big: object) -> object:
    """An instance of which every field that can be long is."""
    annotations = {
        name: str(kind)
        for base in reversed(cls.__mro__)
        for name, kind in vars(base).get("__annotations__", {}).items()
    }
    if issubclass(cls, tuple):
        return cls(*(0 if SMALL.fullmatch(_source(annotations[name])) else big for name in cls._fields))
    instance = object.__new__(cls)
    for field in dataclasses.fields(cls):
        object.__setattr__(instance, field.name, 0 if SMALL.fullmatch(str(field.type)) else big)
    return instance


def _source(annotation: str) -> str:
    """An annotation as it was written."""
    quoted = re.fullmatch(r"ForwardRef\('(.*?)'.*\)", annotation)
    return quoted[1] if quoted else annotation


@pytest.mark.parametrize("cls", holders(), ids=lambda cls: f"{cls.__module__}.{cls.__qualname__}")
def test_no_class_shows_what_it_holds_at_length(cls: type) -> None:
    """A class with the representation that `dataclass` makes would print every id of a map."""
    for big in BIG:
        shown = repr(filled(cls, big))
        assert len(shown) <= MAX_REPR, shown[:1000]
        assert "\n" not in shown
        assert shown.startswith(cls.__qualname__)


def test_everything_within_a_localiser_is_short(tmp_path) -> None:
    """Whatever a person reaches from a localiser and its answer, attribute by attribute, shows in a few lines."""
    model = make_model("rings")
    localiser = Localiser(make_map(tmp_path / "site.map", model, **{f"house{i}": building_update() for i in range(30)}))
    update = building_update(length=60, objects=200)
    answer = localiser.update(update)
    todo, seen, classes = deque([localiser, answer, update]), set(), set()
    while todo:
        thing = todo.popleft()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        if isinstance(thing, dict):
            todo.extend([*thing.values()][:50])
        elif isinstance(thing, list | tuple) and not hasattr(thing, "_fields"):
            todo.extend(thing[:50])
        elif type(thing).__module__.startswith("semloc_core"):
            message = type(thing).__module__ == messages.__name__ and thing is not update  # of bounded length
            if not message:
                shown = repr(thing)
                assert len(shown) <= MAX_REPR, shown[:1000]
            classes.add(type(thing).__name__)
            names = {
                *getattr(thing, "__dict__", {}),
                *getattr(thing, "__struct_fields__", ()),
                *getattr(thing, "_fields", ()),
            }
            todo.extend(getattr(thing, name, None) for name in names)
    wanted = {
        "Localiser",
        "LoadedMap",
        "SceneGraph",
        "Model",
        "Located",
        "Query",
        "Localisation",
        "Batch",
        "Labelspace",
    }
    assert wanted | {"RingsEncoder", "LayoutVerifier", "MappedLayout", "SceneGraphUpdate"} <= classes


def test_a_localiser_says_what_matters(tmp_path) -> None:
    localiser = Localiser(make_map(tmp_path / "site.map", make_model(), home=building_update()))
    assert repr(localiser).startswith("Localiser(map=LoadedMap('site'), config=LocaliserConfig(")
    assert "positions=float64[30, 3]" in repr(localiser.map)
    localiser.update(building_update(objects=7))
    assert "objects=dict of 7" in repr(localiser.live.stream.graph)


def test_arrays_are_shown_by_type_and_shape() -> None:
    @semloc_core.text.representation.short_repr
    @dataclasses.dataclass
    class Holder:
        array: np.ndarray
        tensor: torch.Tensor
        few: tuple[int, ...]
        many: tuple[int, ...]
        data: bytes

    shown = repr(Holder(np.zeros((2, 3), np.float32), torch.zeros(4, dtype=torch.int64), (1, 2), (1,) * 9, b"x" * 99))
    assert shown.endswith("Holder(array=float32[2, 3], tensor=int64[4], few=(1, 2), many=tuple of 9, data=bytes of 99)")


def test_counters_histories_and_encoders() -> None:
    counter = NameCounter()
    for i in range(1000):
        counter.see(f"class {i}", "thing")
    assert repr(counter) == "NameCounter of 1000"
    history = msgspec.convert({"objects": {str(i): {} for i in range(1000)}}, History)
    assert repr(history) == "History(traversals=(), objects=dict of 1000, classes={}, before=None)"
    assert repr(build_encoder("paper", None, 5)) == "PaperEncoder(5 classes, 32 numbers a place)"
