"""Do runs and explainers agree on the classes: measures, rows, and the paper's own rankings put through them."""
