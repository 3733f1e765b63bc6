"""Files: there whole or not at all, and never over what is not theirs."""

from typing import TYPE_CHECKING

from semloc_core.exports import exports

if TYPE_CHECKING:
    from semloc_core.files.kinds import (
        APPLICATION_ID,
        BAG,
        CALIBRATION,
        FIGURES,
        FOLDER,
        GRAPH,
        MAP,
        MESSAGES,
        MODEL,
        PAGE,
        PICTURE,
        STATE,
        STUDY,
        TRAJECTORY,
        kind_of,
        other_kind,
    )
    from semloc_core.files.outputs import Output, guarded
    from semloc_core.files.whole import (
        beside,
        check_claim,
        is_stream,
        link_new,
        must_be_new,
        open_stream,
        publish,
        real,
        remove,
        replaces,
        scratch_folder,
        write_whole,
        written,
    )
else:
    __getattr__ = exports(__name__)

__all__ = [
    "APPLICATION_ID", "BAG", "CALIBRATION", "FIGURES", "FOLDER", "GRAPH", "MAP", "MESSAGES", "MODEL", "Output", "PAGE",
    "PICTURE", "STATE", "STUDY", "TRAJECTORY", "beside", "check_claim", "guarded", "is_stream", "kind_of", "link_new",
    "must_be_new", "open_stream", "other_kind", "publish", "real", "remove", "replaces", "scratch_folder",
    "write_whole", "written",
]  # fmt: skip
