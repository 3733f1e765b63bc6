"""The commands ``semloc evaluate …``."""
