"""Explainers: one a file, each a function from a query to object scores; by name in `by_name`."""
