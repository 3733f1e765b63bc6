"""Files: there whole or not at all, and never over what is not theirs."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.files.whole import write_whole
else:
    __getattr__ = exports(__name__)

__all__ = ["write_whole"]
