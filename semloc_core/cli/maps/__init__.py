"""The commands ``semloc map …``."""
