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
"""Maps are swapped under load: every update is applied, answers never stop, and each is of one map or the other."""

import itertools
import time

import scene
from conftest import wait_for
from scene import Watching, describe, localiser, player

SWAPS = 12


def generate_test_description():
    """Launch a player at 20 Hz."""
    return describe(player(rate_hz=20.0), localiser(explain_rate_hz=5.0))


class TestSwap(Watching):
    """One client sets the parameter while answers are watched."""

    def test_swaps_leave_no_gap(self):
        self.answers_after(20)
        maps = {name: str(scene.ASSETS / f"{name}.map") for name in ("home", "both", "attention", "broken")}
        begin = len(self.client.matches)
        for i in range(SWAPS):
            name = ("both", "attention", "broken", "home")[i % 4]
            assert self.client.set(map=maps[name])[0].successful == (name != "broken")
            if name != "broken":
                wait_for(lambda name=name: self.client.matches[-1].map.name == name, f"answers of {name}")
            time.sleep(0.2)
        answers = self.client.matches[begin:]
        assert {a.map.name for a in answers} == {"home", "both", "attention"}
        assert "no_graph" not in {a.status for a in answers}
        stamps = [a.stamp_ns for a in answers]
        assert max(b - a for a, b in itertools.pairwise(stamps)) < 3e9

        def whole():
            status = self.client.diagnostics("localisation")
            values = {v.key: v.value for v in status.values} if status else {}
            return values if int(values.get("updates received", 0)) > 100 else None

        values = wait_for(whole, "diagnostics")
        assert values["updates rejected"] == "0"
        assert values["gaps in the stream"] == "0"
        assert values["updates received"] == values["updates applied"]
