"""From answer to answer: what the past says of the present one, and what a person does."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.tracking.frame_filter import FrameFilter
    from semloc_core.tracking.hint import LASTS_M, Hint, Hinted
else:
    __getattr__ = exports(__name__)

__all__ = ["FrameFilter", "Hint", "Hinted", "LASTS_M"]
