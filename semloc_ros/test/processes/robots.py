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
"""Two robots in namespaces of their own, on one map file, do not hear each other."""

from conftest import wait_for
from scene import Watching, describe, localiser, player


def generate_test_description():
    """Launch two robots; one of them renames its input."""
    return describe(
        player("one", seed=1, frame_id="one_map"),
        localiser(namespace="one", frame_id="one_answers"),
        player("two", remappings=[("scene_graph", "hydra/graph")], seed=2, frame_id="two_map"),
        localiser(namespace="two", remappings=[("scene_graph", "hydra/graph")], frame_id="two_answers"),
    )


class TestRobots(Watching):
    """Each has its own topics, parameters and diagnostics."""

    names = ("/one/localiser", "/two/localiser")

    def test_each_answers_its_own_updates(self):
        for client in self.clients:
            self.answers_after(10, client)
        one, two = (list(client.matches) for client in self.clients)
        assert {a.frame_id for a in one} == {"one_answers"}
        assert {a.frame_id for a in two} == {"two_answers"}
        assert not {a.stamp_ns for a in one} & {a.stamp_ns for a in two}
        assert {a.map.hash for a in one} == {a.map.hash for a in two}
        topics = dict(self.client.node.get_topic_names_and_types())
        assert "/two/hydra/graph" in topics
        assert self.client.node.count_publishers("/two/scene_graph") == 1  # that of this test, which is never used

    def test_diagnostics_say_which_robot_they_are_of(self):
        for name in self.names:
            wait_for(lambda name=name: self.client.diagnostics(f"{name}: localisation"), f"diagnostics of {name}")

    def test_a_parameter_of_one_is_not_the_others(self):
        assert self.clients[0].set(top_n=2)[0].successful
        assert {len(a.matches) for a in self.answers_after(10, self.clients[0])[-3:]} == {2}
        assert 2 not in {len(a.matches) for a in self.answers_after(5, self.clients[1])}
