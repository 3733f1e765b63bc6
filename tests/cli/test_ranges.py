"""A value out of its range is refused with the range: half of it misleads (`--range -3`: at most 1000)."""

import importlib
import pkgutil
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import typer.main

import semloc_core
from semloc_core.cli import app, main
from semloc_core.config import checked
from semloc_core.errors import ConfigError

SIDES = {"ge": ("at least", -1), "gt": ("more than", 0), "le": ("at most", 1), "lt": ("less than", 0)}
"""Keyword of a bound -> its words, and the direction in which the next number is out of range."""


def ranged() -> Iterator[tuple[type, str, Any]]:
    """Every field with a bound of every configuration struct."""
    for module in pkgutil.walk_packages(semloc_core.__path__, "semloc_core."):
        if module.name.endswith("__main__"):
            continue
        for cls in vars(importlib.import_module(module.name)).values():
            if not (isinstance(cls, type) and issubclass(cls, msgspec.Struct) and cls.__module__ == module.name):
                continue
            if cls.__name__.endswith("Config"):
                for field in msgspec.inspect.type_info(cls).fields:  # type: ignore[union-attr]
                    kind = field.type
                    for one in kind.types if isinstance(kind, msgspec.inspect.UnionType) else (kind,):
                        if bounds(one):
                            yield cls, field.name, one


def bounds(kind: Any) -> dict[str, float]:
    while isinstance(kind, msgspec.inspect.Metadata):
        kind = kind.type
    return {side: bound for side in SIDES if (bound := getattr(kind, side, None)) is not None}


RANGED = {f"{cls.__name__}.{name}": (cls, name, bounds(kind)) for cls, name, kind in ranged()}


def test_the_configurations_have_ranges() -> None:
    assert len(RANGED) > 60, sorted(RANGED)
    assert "SimulationConfig.range_m" in RANGED


@pytest.mark.parametrize("which", RANGED)
def test_a_refusal_names_every_bound(which: str) -> None:
    cls, name, found = RANGED[which]
    for side, bound in found.items():
        wrong = bound + SIDES[side][1]
        with pytest.raises(ConfigError) as refused:
            checked(cls, **{name: wrong})
        for other, limit in found.items():
            assert f"{SIDES[other][0]} {limit:g}" in str(refused.value)
        assert str(refused.value).startswith(f"expected {name} to be a ")
        assert f"(got '{wrong}')" in str(refused.value)


def test_a_nested_option_and_an_item_of_a_list_are_named_with_their_range() -> None:
    from semloc_core.encoding.encoder.rings import RingsConfig
    from semloc_core.training.config import TrainConfig

    with pytest.raises(
        ConfigError, match=r"^expected validate\.drop_probability to be a number of at least 0 and at m"
    ):
        checked(TrainConfig, validate={"drop_probability": 2.0})
    with pytest.raises(ConfigError, match=r"^expected widths to be a number of more than 0 and at most 1000 \(got "):
        checked(RingsConfig, widths=[1.0, -1.0])


def commands(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, sub in getattr(command, "commands", {}).items():
        yield from commands(sub, (*words, name))
    if not hasattr(command, "commands"):
        yield words, command


def limits(option: Any) -> tuple[float | None, float | None]:
    """Least and largest value; the libraries of different versions keep them in different places."""
    kind = getattr(option, "type", None)
    return tuple(getattr(option, side, None) or getattr(kind, side, None) for side in ("min", "max"))


OPTIONS = {
    f"{' '.join(words)} {option.opts[0]}": (words, option.opts[0], limits(option))
    for words, command in commands(typer.main.get_command(app))
    for option in command.params
    if any(
        getattr(of, side, None) is not None for side in ("min", "max") for of in (option, getattr(option, "type", 0))
    )
}


def test_commands_have_ranged_options() -> None:
    assert len(OPTIONS) > 40, sorted(OPTIONS)


@pytest.mark.parametrize("which", OPTIONS)
def test_a_command_names_the_bound_that_is_broken_of_its_option(which: str, monkeypatch: Any, capsys: Any) -> None:
    words, name, (low, high) = OPTIONS[which]
    low = low or 0  # where it is none, no option has another
    for wrong in (low - 1, *([high + 1] if high is not None else [])):
        monkeypatch.setattr(sys, "argv", ["semloc", *words, name, str(wrong)])
        with pytest.raises(SystemExit, match="2"):
            main()
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert name in said
        bound = low if wrong < low else high
        assert re.search(rf"(?<![\d.]){re.escape(f'{bound:g}')}(?![\d.])", said), said


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--range", "-3", "expected range_m to be a number of more than 0 and at most 1000 (got '-3.0')"),
        ("--range", "1001", "expected range_m to be a number of more than 0 and at most 1000 (got '1001.0')"),
        ("--speed", "0", "expected speed_mps to be a number of more than 0 and at most 100 (got '0.0')"),
        ("--rate", "nan", "expected rate_hz to be a number of more than 0 and at most 1000 (got 'nan')"),
    ],
)
def test_simulate(
    option: str, value: str, said: str, data_root: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    graph = next((data_root / "gibson").glob("*/map.json"))
    monkeypatch.setattr(
        sys, "argv", ["semloc", "bag", "simulate", str(graph), "-o", f"{tmp_path}/a.mcap", option, value]
    )
    with pytest.raises(SystemExit, match="2"):
        main()
    assert capsys.readouterr().err == f"semloc: {said}\n"
