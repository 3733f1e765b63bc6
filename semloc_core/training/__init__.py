"""Self-supervised training on map graphs: perturbed variants of a building, losses, the seeded and resumable loop."""
