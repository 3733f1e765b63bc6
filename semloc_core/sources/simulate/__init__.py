"""A robot walks through a graph, and the graph is revealed as its sensors would see it."""

from semloc_core.sources.simulate.traversal import SimulationConfig, Step, simulate_traversal

__all__ = ["SimulationConfig", "Step", "simulate_traversal"]
