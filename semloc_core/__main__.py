"""``python -m semloc_core`` is the command ``semloc``."""

from semloc_core.cli import main

main()
