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
from semloc_core.cli.shared.words import kind, limits, name
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
    for word, sub in getattr(command, "commands", {}).items():
        yield from commands(sub, (*words, word))
    if not hasattr(command, "commands"):
        yield words, command


OPTIONS = {
    f"{' '.join(words)} {option.opts[0]}": (words, command, option)
    for words, command in commands(typer.main.get_command(app))
    for option in command.params
    if kind(option) in (int, float)
}
"""Every option of every command that takes a number."""


def test_commands_have_options_with_numbers() -> None:
    assert len(OPTIONS) > 80, sorted(OPTIONS)
    assert "bag simulate --range" in OPTIONS
    assert "bench fleet --homes" in OPTIONS


@pytest.mark.parametrize("which", OPTIONS)
def test_a_number_out_of_range_is_refused_before_any_file_is_looked_for(
    which: str, monkeypatch: Any, capsys: Any, tmp_path: Path
) -> None:
    words, command, option = OPTIONS[which]
    monkeypatch.chdir(tmp_path)
    needed: list[str] = []
    for other in command.params:
        if other.required:
            needed += ["none"] if other.param_type_name == "argument" else [name(other), "none"]
    low, high = limits(option)
    beyond = [high + 1] if high is not None else [10**30]
    for wrong in (
        -1 if low is None else low - 1,
        "nan",
        "-inf",
        *beyond,
        *([0] if low is not None and low > 0 else []),
    ):
        monkeypatch.setattr(sys, "argv", ["semloc", *words, *needed, option.opts[0], str(wrong)])
        with pytest.raises(SystemExit, match="2"):
            main()
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert re.match(rf"semloc: expected {name(option)} to be a (whole )?number( of .*)? \(got '", said), said
        bound = None if isinstance(wrong, str) else low if wrong < (low or 0) else high
        if bound is not None:
            assert re.search(
                rf"(?<![\d.]){re.escape(f'{bound:.15g}' if isinstance(bound, float) else f'{bound}')}\b", said
            )
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--range", "-3", "expected --range to be a number of more than 0 and at most 1000 (got '-3.0')"),
        ("--range", "1001", "expected --range to be a number of more than 0 and at most 1000 (got '1001.0')"),
        ("--speed", "0", "expected --speed to be a number of more than 0 and at most 100 (got '0.0')"),
        ("--rate", "nan", "expected --rate to be a number of more than 0 and at most 1000 (got 'nan')"),
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
