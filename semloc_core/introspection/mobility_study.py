"""Are classes weighted down whose objects move between traversals? An experiment on the training itself.

From the same first weights two models are trained on traversals of the same building. In one the first half of the
classes moves from traversal to traversal and the other stays where it is; in the other it is the other way round. Both
explain the same places. What importance a class has when it moves, less what it has at rest, is then due to
the movement, and to nothing that the class is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from semloc_core.evaluate import SEEDS, office_variants
from semloc_core.explain import EXPLAINERS
from semloc_core.graph import Floats, GraphArrays, Labelspace
from semloc_core.introspection.class_ablation import class_frequencies
from semloc_core.introspection.whole_map import introspect_map
from semloc_core.metrics import Progress, no_progress
from semloc_core.text import short_repr
from semloc_core.training import TrainConfig, train_config

MOVED_M = 2.0
"""Standard deviation of x and of y of an object that moves, metres."""
PLACES = 200


@short_repr
@dataclass(frozen=True, eq=False)
class MobilityRun:
    """Of one seed.

    Args:
        group: the classes that moved in the first training, and stood in the second.
        positions: (Q, 3) of the places explained, metres.
        change: explainer -> (Q,) share of the group's objects when they move, less their share at rest. Because shares
            sum to 1, it is the other classes' change as well.

    """

    group: tuple[str, ...]
    positions: Floats
    change: Mapping[str, Floats]


def mobility_study(
    arrays: GraphArrays,
    labelspace: Labelspace,
    *,
    seeds: Sequence[int] = SEEDS,
    config: TrainConfig | None = None,
    methods: Sequence[str] = tuple(EXPLAINERS),
    moved_m: float = MOVED_M,
    n_places: int = PLACES,
    progress: Progress = no_progress,
) -> list[MobilityRun]:
    """Run the experiment once for each seed.

    Args:
        arrays: the building.
        labelspace: its classes. Where it knows some to be more mobile than others, they are the group; else every
            second class by frequency is.
        seeds: the runs.
        config: options of the training, the encoder among them; None: the paper's encoder. The seed is overridden.
        methods: explainers.
        moved_m: how far objects move that do, standard deviation of x and of y.
        n_places: how many places are explained.
        progress: told of every step.

    """
    from semloc_core.training import Report, train

    config = config or train_config("paper")
    group, rest = groups(class_frequencies(arrays, labelspace), labelspace)
    found = []
    for number, seed in enumerate(seeds, start=1):
        query, reference = office_variants(arrays, labelspace, seed)
        count = min(n_places, arrays.n_places)
        places = np.sort(np.random.default_rng([seed, 5]).choice(arrays.n_places, count, replace=False)).tolist()
        members = np.isin(query.object_classes, [labelspace.index(name) for name in group])
        shares = []
        for moving in (group, rest):
            words = f"traversals {number}, {', '.join(moving)} moving"

            def report(step: Report, words: str = words) -> None:
                progress(step.step, config.steps, words)

            space = replace(labelspace, mobility=dict.fromkeys(moving, moved_m), default_mobility=0.0)
            options = msgspec.structs.replace(config, seed=seed)
            model = train([arrays], space, options, progress=report).model
            seen = introspect_map(
                model, query, reference, methods=methods, places=places, with_fidelity=False, seed=seed,
                progress=progress, words=words,
            )  # fmt: skip
            shares.append({m: of[:, members].sum(1, dtype=np.float64) for m, of in seen.shares.items()})
        found.append(
            MobilityRun(
                group=group,
                positions=query.place_positions[seen.places],
                change={method: shares[0][method] - shares[1][method] for method in methods},
            )
        )
    return found


def groups(frequency: Mapping[str, float], labelspace: Labelspace) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The classes known to be more mobile than the median class; where none is, every second one by frequency."""
    order = sorted(frequency, key=lambda name: (-frequency[name], name))
    middle = float(np.median([labelspace.mobility_of(name) for name in order]))
    mobile = tuple(name for name in order if labelspace.mobility_of(name) > middle) or tuple(order[::2])
    return mobile, tuple(name for name in order if name not in mobile)
