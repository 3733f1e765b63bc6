"""One update: step by step, and by how many buildings the map has."""
