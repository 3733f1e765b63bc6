"""Shapley values of any game: exactly over all coalitions, or sampled over permutations.

A game gives each coalition of players a value. Shapley, "A Value for n-Person Games", 1953; sampling after Štrumbelj
and Kononenko, "An Efficient Explanation of Individual Classifications using Game Theory", JMLR 2010.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semloc_core.errors import ConfigError
from semloc_core.graph import Floats
from semloc_core.text import short_repr

Game = Callable[[NDArray[np.bool_]], Floats]
"""(K, players) bool, who is in each coalition -> (K,) float64, its value. Asked with many coalitions at once."""

MAX_EXACT_PLAYERS = 20


@short_repr
@dataclass(frozen=True, eq=False)
class ShapleyValues:
    """The players' values.

    Args:
        values: (players,) float64.
        standard_error: (players,) float64, or None where the values are exact.
        gap: v(everyone) - v(no one) - Σ values; zero but for rounding, by exact computation and by sampling.

    """

    values: Floats
    standard_error: Floats | None
    gap: float


def all_coalitions(players: int) -> NDArray[np.bool_]:
    """(2^players, players) bool; player i is in coalition k where bit i of k is set."""
    numbers = np.arange(2**players, dtype=np.int64)
    present: NDArray[np.bool_] = (numbers[:, None] >> np.arange(players)) & 1 == 1
    return present


def exact_values(game: Game, players: int) -> ShapleyValues:
    """φ_i = Σ_{S ∌ i} |S|! (n-|S|-1)! / n! · (v(S ∪ i) - v(S)), over all 2^n coalitions, asked for at once.

    Raises:
        ConfigError: more than `MAX_EXACT_PLAYERS` players.

    """
    if players > MAX_EXACT_PLAYERS:
        raise ConfigError(f"expected at most {MAX_EXACT_PLAYERS} players for exact Shapley values (got {players})")
    present = all_coalitions(players)
    value = game(present)
    numbers, size = np.arange(len(present)), present.sum(1)
    weight = np.array([1.0 / (players * math.comb(players - 1, s)) for s in range(players)])
    values = np.zeros(players)
    for i in range(players):
        without = numbers[~present[:, i]]
        values[i] = float(weight[size[without]] @ (value[without | (1 << i)] - value[without]))
    return ShapleyValues(values, None, float(value[-1] - value[0] - values.sum()))


def sampled_values(game: Game, players: int, permutations: int, rng: np.random.Generator) -> ShapleyValues:
    """Mean marginal contribution over random orders in which the players join; all coalitions asked for at once.

    Args:
        game: the game.
        players: how many players.
        permutations: how many orders are drawn; at least 2, so that there is a standard error.
        rng: draws the orders.

    Raises:
        ConfigError: fewer than two permutations.

    """
    if permutations < 2:
        raise ConfigError(f"expected at least 2 permutations (got {permutations})")
    orders = rng.permuted(np.tile(np.arange(players), (permutations, 1)), axis=1)
    place = np.argsort(orders, axis=1)  # (permutations, players): when each joins
    present = place[:, None, :] < np.arange(players + 1)[None, :, None]  # (permutations, joined, players)
    value = game(present.reshape(-1, players)).reshape(permutations, players + 1)
    marginal = np.take_along_axis(np.diff(value, axis=1), place, axis=1)
    values = marginal.mean(0)
    error = marginal.std(0, ddof=1) / math.sqrt(permutations)
    return ShapleyValues(values, error, float(value[0, -1] - value[0, 0] - values.sum()))
