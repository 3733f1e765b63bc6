"""Where graphs and runs come from: Hydra's files, bags, simulated walks, generated buildings."""
