"""What ``semloc explain`` prints: what the answer is, where, why, why not elsewhere, and what would change it."""

from semloc_core.cli.explained.brief import print_brief
from semloc_core.cli.explained.whole import print_answer, print_explanation

__all__ = ["print_answer", "print_brief", "print_explanation"]
