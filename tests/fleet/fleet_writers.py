"""What the processes do that change a map on a server, each with a connection of its own."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import torch
from killing import Calls, kill_oneself
from map_cases import Building, make_building, make_model

from semloc_core.encoding.model import Model
from semloc_core.fleet.milvus.address import MilvusAddress
from semloc_core.fleet.source import Fetched
from semloc_core.fleet.writing import database as _preloaded  # noqa: F401
from semloc_core.fleet.writing.database import FleetDatabase

SIZES = (20, 31)  # places of the two variants of a building


def variants(model: Model) -> list[Building]:
    """Two buildings that differ in everything, the number of places included."""
    return [make_building(model, size, seed) for seed, size in enumerate(SIZES, 1)]


def which(fetched: Fetched, known: list[Building]) -> int:
    """Which variant a building is, whole; -1 for none."""
    for i, (_, ids, positions, embeddings) in enumerate(known):
        places = fetched.places
        if (
            list(places.ids) == ids
            and np.array_equal(places.positions, positions)
            and np.array_equal(places.embeddings, embeddings)
        ):
            return i
    return -1


def add(address: MilvusAddress, said: Connection, names: list[str]) -> None:
    """Add buildings, each by a change of its own."""
    model = make_model()
    with FleetDatabase.open(address) as database:
        said.send("begun")
        for name in names:
            database.add_building(name, *building_named(model, name))
    said.send("done")


def building_named(model: Model, name: str) -> Building:
    """The building that goes by this name."""
    return make_building(model, 5 + len(name), sum(name.encode()))


def replace(address: MilvusAddress, said: Connection, name: str, first: int, times: int) -> None:
    """Replace a building by its variants in turn."""
    both = variants(make_model())
    with FleetDatabase.open(address) as database:
        said.send("begun")
        for i in range(times):
            database.replace_building(name, *both[(first + i) % 2])
    said.send("done")


def churn(address: MilvusAddress, said: Connection, plan: list[str], at: float) -> None:
    """Add, replace and remove by a plan; each change is reported after it. Killed at the call ``at`` of ours.

    At the end it says how many there were: those of the project's own files, which are always the same.
    """
    both = variants(make_model())
    calls = Calls(at, kill_oneself, within="semloc_core")
    with FleetDatabase.open(address) as database:
        said.send("begun")
        calls.begin()
        for change in plan:
            verb, name, variant = change.split()
            if verb == "remove":
                database.remove_building(name)
            else:
                put = database.add_building if verb == "add" else database.replace_building
                put(name, *both[int(variant)])
            said.send(change)
        said.send(f"calls {calls.end()}")


def start(work: Callable[..., None], *args: object) -> tuple[BaseProcess, Connection]:
    """Run ``work`` in a process of its own, once it says that it has begun; what it says comes through the pipe.

    Forked from a process that has imported everything and connected to nothing: grpc does not survive a fork.
    """
    context = multiprocessing.get_context("forkserver")
    here, there = context.Pipe(duplex=False)
    address, *rest = args
    child = context.Process(target=_quiet, args=(work, address, there, *rest))
    child.start()
    there.close()
    assert here.recv() == "begun"
    return child, here


def _quiet(work: Callable[..., None], *args: object) -> None:
    torch.set_num_threads(1)
    os.nice(5)
    work(*args)


def preload() -> None:
    """Let the process that all writers are forked from import what they need."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(["fleet_writers", "pymilvus", "pytest"])
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    try:
        forkserver.ensure_running()  # it looks for modules where the environment says, not where we do
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
