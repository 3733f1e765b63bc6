"""What is wrong with a command's words, and with its numbers before anything is read: one line that names the option.

Typer's own words change from version to version, and name a bound but not the range.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, get_args, get_origin

import typer

from semloc_core.config import checked
from semloc_core.errors import ConfigError

MOST = 10**9
"""A number whose option says no more is at most this: beyond, it is a slip, and what it asks for would never end."""


def within(struct: Callable[[], type[Any]], field: str) -> Callable[..., Any]:
    """The callback of an option that is a field of a configuration struct: its type and range are those of the field.

    Args:
        struct: imports the struct.
        field: its name there.

    Raises:
        ConfigError: of the callback, where the value is none that the field can have; the line names the option.

    """

    def check(param: typer.CallbackParam, value: Any) -> Any:
        if value is not None:
            try:
                checked(struct(), **{field: value})
            except ConfigError as error:
                raise ConfigError(str(error).replace(f"expected {field} ", f"expected {name(param)} ", 1)) from error
        return value

    return check


def name(parameter: Any) -> str:
    """An option's long name, an argument's word."""
    return max(parameter.opts, key=len) if parameter.param_type_name == "option" else str(parameter.metavar)


def kind(parameter: Any) -> Any:
    """The type of a parameter's values (of each, if it may be repeated), or the tuple of its choices; None: others."""
    described = getattr(parameter, "type_descriptor", None)  # of newer typers; click's type before
    if described is None:
        own = getattr(parameter.type, "choices", None)
        said = str(getattr(parameter.type, "name", ""))
        return tuple(own) if own else int if "int" in said else float if "float" in said else None
    found = described.annotation
    while not isinstance(found, type) and get_origin(found) is not Literal and get_args(found):
        found = get_args(found)[0]
    return get_args(found) if get_origin(found) is Literal else found if found in (int, float) else None


def limits(parameter: Any) -> tuple[float | None, float | None]:
    """Least and largest value of a number, where its option says so."""
    at = getattr(getattr(parameter, "type_descriptor", None), "parameter_info", getattr(parameter, "type", None))
    low, high = (getattr(at, side, None) for side in ("min", "max"))
    return low, high


def check_numbers(parameters: Sequence[Any], values: dict[str, Any]) -> None:
    """Refuse a number that no option of its kind can have.

    Raises:
        ConfigError: it is no number, or out of its option's range.

    """
    for parameter in parameters:
        value = values.get(parameter.name or "")
        if kind(parameter) not in (int, float) or value is None:
            continue
        low, high = limits(parameter)
        for each in value if isinstance(value, list | tuple) else [value]:
            least, most = (-MOST if low is None else low), (MOST if high is None else high)
            if not least <= each <= most:
                raise ConfigError(_expected(parameter, str(each)))


def wrong_words(error: Any, words: Sequence[str], command: Any) -> str:
    """One line on words that typer (or click) refuses.

    Args:
        error: of theirs.
        words: all that were typed after the command's name.
        command: the whole of it.

    """
    text, parameter = error.format_message().strip(), getattr(error, "param", None)
    got = "" if parameter is None else ", ".join(_given(parameter, words))
    if got and kind(parameter) is not None:
        text = _expected(parameter, got)
    context = getattr(error, "ctx", None)
    # Of an option without its value the parser knows of no command.
    path = " ".join(["semloc", *_of_command(command, words)]) if context is None else context.command_path
    return f"{text[:1].lower()}{text[1:].rstrip('.')} (see {path} --help)"


def _expected(parameter: Any, got: str) -> str:
    what = kind(parameter)
    if isinstance(what, tuple):
        return f"expected {name(parameter)} to be one of {', '.join(map(str, what))} (got {got!r})"
    low, high = limits(parameter)
    if high is None and not _below(got, MOST):
        high = MOST
    bounds = " and ".join(
        f"{words} {bound if isinstance(bound, int) else f'{bound:.15g}'}"
        for words, bound in (("at least", low), ("at most", high))
        if bound is not None
    )
    of = f" of {bounds}" if bounds else ""
    return f"expected {name(parameter)} to be a {'whole ' * (what is int)}number{of} (got {got!r})"


def _below(got: str, most: float) -> bool:
    try:
        return float(got) <= most or math.isnan(float(got))
    except ValueError:
        return True


def _given(parameter: Any, words: Sequence[str]) -> Iterator[str]:
    """What was typed for an option."""
    for i, word in enumerate(words):
        option, equals, value = word.partition("=")
        if option in parameter.opts:
            yield from [value] if equals else words[i + 1 : i + 2]


def _of_command(command: Any, words: Sequence[str]) -> list[str]:
    """Those of the words that name a command within a command."""
    found: list[str] = []
    for word in words:
        command = getattr(command, "commands", {}).get(word)
        if command is None:
            break
        found.append(word)
    return found
