"""From answer to answer: a Bayes filter over the places of a map."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.tracking.filter_model import FilterConfig, MapModel, MapPart, joined_model, map_model
    from semloc_core.tracking.hint import LASTS_M, Hint
    from semloc_core.tracking.place_filter import PlaceFilter
    from semloc_core.tracking.tracker import Tracker, filter_part
else:
    __getattr__ = exports(__name__)

__all__ = [
    "FilterConfig", "Hint", "LASTS_M", "MapModel", "MapPart", "PlaceFilter", "Tracker", "filter_part", "joined_model",
    "map_model",
]  # fmt: skip
