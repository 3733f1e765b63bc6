"""The localiser's options: the one source of default, unit, range and description of each.

Command line and node derive their options and parameters from here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import UnionType
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta

from semloc_core.errors import ConfigError

MATCH_RADIUS_M = 4.0
"""Two places within this distance are one answer (paper, section IV-B2: the matching radius)."""

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Spread = Annotated[float, Meta(ge=0.0, le=100.0)]
"""A standard deviation, or a factor on one."""
Some = Annotated[float, Meta(gt=0.0, le=1000.0)]
"""How far or how often: more than nothing."""


class LocaliserConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of `semloc_core.localiser.Localiser`; each field's metadata says what it is and its range."""

    top_n: Annotated[int, Meta(ge=1, le=100, description="how many places a match message lists")] = 10
    explainer: Annotated[
        Literal["attention", "integrated_gradients", "saliency", "shapley_sampling", "class_shapley", "layout"],
        Meta(
            description="how objects are credited: by the embedding's similarity (for attention, an encoder without it "
            "answers in closed form), or, layout, by the test that decides where it is on",
        ),
    ] = "attention"
    explain_rate_hz: Annotated[
        float,
        Meta(
            ge=0.0,
            le=1000.0,
            description="attributions per second of message time at most, in Hz; 0 turns them off",
        ),
    ] = 5.0
    frame_id: Annotated[
        str,
        Meta(
            pattern=r"\A[^/\s\x00-\x1f\x7f][^\x00-\x1f\x7f]*\Z",  # tf2 knows no frame that begins with a slash
            title="the name of a frame, without a slash before it",
            description="frame of the matched building, and of what is published: a name, in which {building} stands "
            "for the building's; map: the building's name where the map holds several",
        ),
    ] = "map"
    accept_probability: Annotated[
        float,
        Meta(ge=0.0, le=1.0, description="the status is match from this probability of the best place on"),
    ] = 0.9
    rerank: Annotated[
        Literal["none", "layout"],
        Meta(
            description="none: places by similarity alone; layout: the likeliest ones are put to the test, by whether "
            "objects and free space lie around the robot as they do there",
        ),
    ] = "layout"
    filter: Annotated[
        Literal["none", "bayes"],
        Meta(
            description="none: each answer by itself; bayes: those before it, from beyond the reach of its test, weigh "
            "in too, by where each has the run's frame (with rerank: layout)",
        ),
    ] = "none"
    buildings: Annotated[
        tuple[str, ...],
        Meta(
            description="only these buildings of the map, by patterns over their names such as hq/*; none: all",
        ),
    ] = ()
    labelspace: Annotated[
        str,
        Meta(description="names for class numbers: a shipped labelspace or a YAML file; empty: the map's own"),
    ] = ""
    synonyms: Annotated[
        str,
        Meta(
            description="joins the detector's names to the map's: a YAML file, or auto, the shipped cross-walk of "
            "label sets; empty: they are the map's",
        ),
    ] = ""
    server_timeout_s: Annotated[
        float,
        Meta(ge=0.05, le=60.0, description="a map's server that takes longer counts as lost, in s"),
    ] = 2.0
    server_poll_s: Annotated[
        float,
        Meta(ge=0.05, le=3600.0, description="how often a map's server is asked whether the map has changed, in s"),
    ] = 2.0
    max_update_bytes: Annotated[
        int, Meta(ge=1024, le=2**30, description="a larger update is refused, in bytes of JSON")
    ] = 16 * 2**20


class Option(msgspec.Struct, frozen=True):
    """One field of a configuration struct, for whoever shows or sets it."""

    name: str
    type: type
    default: Any
    description: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]


def options(struct: type[msgspec.Struct]) -> list[Option]:
    """Describe the fields of a configuration struct, in order."""
    hints = get_type_hints(struct, include_extras=True)
    defaults = struct()
    found = []
    for name in struct.__struct_fields__:
        hint, metas = hints[name], []
        if get_origin(hint) is Annotated:
            hint, *metas = get_args(hint)
        description, minimum, maximum = (
            next((value for meta in metas if (value := getattr(meta, what)) is not None), None)
            for what in ("description", "ge", "le")
        )
        choices = tuple(get_args(hint)) if get_origin(hint) is Literal else ()
        hint = get_origin(hint) or hint
        found.append(
            Option(
                name=name,
                type=str if choices else hint,
                default=getattr(defaults, name),
                description=description or "",
                minimum=minimum,
                maximum=maximum,
                choices=choices,
            )
        )
    return found


class Checked(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options that are made with `of`, which checks types and ranges."""

    @classmethod
    def of(cls, **values: object) -> Self:
        """Make a configuration with types and ranges checked.

        Raises:
            ConfigError: an option is unknown, of another type or out of its range.

        """
        config: Self = checked(cls, **values)
        return config


def checked(struct: type[Any], **values: Any) -> Any:
    """Make a configuration struct, with types and ranges checked.

    Raises:
        ConfigError: a value is of another type or out of its range; the line names the option.

    """
    try:
        return msgspec.convert(values, struct, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(_why_not(struct, values, str(error))) from error


def _why_not(struct: type[Any], values: Mapping[str, Any], error: str) -> str:
    """What was expected of which option; the library's words where they name none."""
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", error):
        names = ", ".join(field.name for field in msgspec.structs.fields(struct))
        return f"expected an option among {names} (got {unknown[1]!r})"
    path = re.findall(r"[^\W\d]\w*|\[", error.rpartition("`$.")[2].partition("`")[0] if "`$." in error else "")
    hint: Any = struct
    value: Any = values
    for step in path:  # an option, an item of a list, an option within an option
        hint = _items(hint) if step == "[" else get_type_hints(_plain(hint), include_extras=True).get(step)
        if step != "[":
            value = value.get(step) if isinstance(value, Mapping) else getattr(value, step, None)
        if hint is None:
            return error
    if not path:
        return error
    name, got = ".".join(step for step in path if step != "["), f"(got {str(value)[:80]!r})"
    plain = _plain(hint)
    if get_origin(plain) is Literal:
        return f"expected {name} to be one of {', '.join(get_args(plain))} {got}"
    for title in (meta.title for meta in get_args(hint) if isinstance(meta, Meta) and meta.title):
        return f"expected {name} to be {title} {got}"
    bounds = " and ".join(_bounds(hint))
    kinds = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
    return f"expected {name} to be {' of '.join(filter(None, [kinds.get(plain, 'a list'), bounds]))} {got}"


def _plain(hint: Any) -> Any:
    """A type without what is said of it, and without None where that is allowed too."""
    while get_origin(hint) in (Annotated, Union, UnionType):
        hint = get_args(hint)[0]
    return hint


def _items(hint: Any) -> Any:
    """The type of a list's items."""
    return next(iter(get_args(_plain(hint))), None)


def _bounds(hint: Any) -> list[str]:
    """Every bound of a type in words, lower ones first."""
    words = (("ge", "at least"), ("gt", "more than"), ("le", "at most"), ("lt", "less than"))
    found: list[str] = []
    while get_origin(hint) in (Annotated, Union, UnionType):
        metas = [meta for meta in get_args(hint)[1:] if isinstance(meta, Meta)]
        found += [
            f"{text} {bound:g}" for meta in metas for side, text in words if (bound := getattr(meta, side)) is not None
        ]
        hint = get_args(hint)[0]
    return found
