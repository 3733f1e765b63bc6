"""Another day's view of a building: perturbed variants, other furnishings, what is known after a few metres."""
