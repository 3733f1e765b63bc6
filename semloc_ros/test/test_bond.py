# Copyright 2026 The semloc maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The bond with a lifecycle manager: while the node is active, and only where it is asked for."""

import sys
import types

import pytest
from conftest import wait_for
from rclpy.lifecycle import TransitionCallbackReturn


class Recorded:
    """What is asked of bondpy, where that is not installed."""

    made: list = []  # noqa: RUF012

    def __init__(self, node, topic, bond_id):
        self.asked = [(topic, bond_id)]
        Recorded.made.append(self)

    def start(self):
        self.asked.append((self.heartbeat_period, self.heartbeat_timeout))

    def shutdown(self):
        self.asked.append("shutdown")


@pytest.fixture
def made(monkeypatch):
    """Stand in for bondpy."""
    module = types.ModuleType("bondpy.bondpy")
    module.Bond = Recorded
    monkeypatch.setitem(sys.modules, "bondpy", types.ModuleType("bondpy"))
    monkeypatch.setitem(sys.modules, "bondpy.bondpy", module)
    monkeypatch.setattr(Recorded, "made", [])
    return Recorded.made


def test_a_bond_lasts_as_long_as_the_node_is_active(localiser, made):
    node = localiser(bond=True)
    assert [bond.asked for bond in made] == [[("bond", "localiser"), (0.1, 60.0)]]
    node.trigger_deactivate()
    assert made[0].asked[-1] == "shutdown"
    node.trigger_activate()
    assert len(made) == 2
    node.trigger_shutdown()
    assert [bond.asked[2:] for bond in made] == [["shutdown"], ["shutdown"]]


def test_without_being_asked_there_is_none(localiser, made):
    assert localiser().state == "active"
    assert made == []


def test_where_bondpy_is_not_installed_activating_says_so(localiser, client, monkeypatch):
    monkeypatch.setitem(sys.modules, "bondpy", None)
    node = localiser(start=False, bond=True)
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() == TransitionCallbackReturn.FAILURE
    side = client()
    wait_for(lambda: (d := side.diagnostics("localisation")) and "expected bondpy" in d.message, "the reason")
    assert node.state == "inactive"


def test_with_bondpy_itself_it_is_formed_and_broken(localiser, client):
    bondpy = pytest.importorskip("bondpy.bondpy")
    node, side = localiser(bond=True), client()
    manager = bondpy.Bond(side.node, "bond", "localiser")
    manager.start()
    try:
        wait_for(lambda: manager.sm.getState().getName() == "SM.Alive", "the bond")
        node.trigger_deactivate()
        wait_for(manager.is_broken, "its end")
    finally:
        manager.shutdown()
