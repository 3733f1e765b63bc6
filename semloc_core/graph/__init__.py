"""The scene graph: as the robot knows it, as a stream of updates, and frozen into arrays. No torch here."""
