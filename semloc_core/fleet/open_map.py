"""From what a person calls a map, a file or an address, to a localiser in it."""

from __future__ import annotations

import math

import numpy as np

from semloc_core.config import LocaliserConfig
from semloc_core.errors import MapUnavailableError
from semloc_core.fleet.file_source import LoadedSource
from semloc_core.fleet.link import Link
from semloc_core.fleet.localiser import FleetLocaliser, LargeMapLocaliser
from semloc_core.fleet.milvus.address import is_address, parse_address
from semloc_core.fleet.milvus.source import MilvusSource
from semloc_core.localiser import Localiser
from semloc_core.map_database import LoadedMap, load

WHOLE_PLACES = 300_000
"""A map in memory of so many places at most, some 1,000 homes, is looked at whole: a list of its buildings would take a
second or two whenever a robot begins anew. A place takes some 5 kB, and a tenth of a millisecond once, at the start."""


def open_localiser(
    map_: str,
    config: LocaliserConfig | None = None,
    *,
    wait: bool = False,
    patience_s: float = math.inf,
    outage_s: float = 0.0,
) -> Localiser:
    """A localiser in a map.

    Args:
        map_: path of a map file, or ``milvus+http://host:port/name``. A file of more than `WHOLE_PLACES` is narrowed
            to some of its buildings, as a map on a server is.
        config: options.
        wait: a server that is not there yet is waited for: until it is, there is no map, and no answer.
        patience_s: how long one answer may fetch buildings from a server, see `FleetLocaliser`.

        outage_s: how long an update waits for a server that has stopped answering before it raises MapUnavailableError;
            0: it does not wait, and its answer is ``no_graph``.

    Raises:
        MapError: no map, a damaged one, or one without the buildings asked for.
        MapUnavailableError: its server does not answer, and ``wait`` is false.

    """
    config = config or LocaliserConfig()
    if not is_address(map_):
        return localiser_in(load(map_), config)
    source = MilvusSource(parse_address(map_), config.server_timeout_s, config.server_poll_s)
    link = Link(source, np.random.default_rng())
    localiser = FleetLocaliser(link, config, patience_s=patience_s)
    try:
        localiser.refresh()
    except MapUnavailableError:
        if not wait:
            localiser.close()
            raise
    except BaseException:
        localiser.close()
        raise
    link.outage_s = outage_s  # from here on: a wrong address is told at once
    return localiser


def localiser_in(loaded: LoadedMap, config: LocaliserConfig | None = None) -> Localiser:
    """A localiser in a map in memory; where that is too large for one answer, narrowed as `open_localiser` says.

    Raises:
        MapError: a map without the buildings asked for.

    """
    config = config or LocaliserConfig()
    asked_for = loaded.narrowed(config.buildings)
    if asked_for.n_places <= WHOLE_PLACES:
        return Localiser(asked_for, config)
    large = LargeMapLocaliser(Link(LoadedSource(loaded), np.random.default_rng(0)), config)
    large.refresh()
    return large
