"""What is said to a person: shares of a whole, and what holds arrays in a line."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.text.representation import short_repr
    from semloc_core.text.shares import percent, summing
else:
    __getattr__ = exports(__name__)

__all__ = ["percent", "short_repr", "summing"]
