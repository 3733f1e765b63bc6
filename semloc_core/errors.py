"""One family of errors.

Every message says what was expected and, in brackets, what was found: ``expected … (got …)``. Library code
raises these and neither prints nor exits; the command line turns one into a single line and exit status 2.
"""

from __future__ import annotations

LONGEST = 1000


class SemlocError(Exception):
    """Base of every error that semloc raises on purpose.

    Its text is one printable line of at most 1000 characters, whatever a file or another machine put into it.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if not text.isprintable():
            text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: LONGEST + 1])
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


class MessageError(SemlocError):
    """A message on the wire is not what its schema says; it was refused whole."""


class GraphError(SemlocError):
    """An update does not fit the graph that it is applied to; the graph is unchanged."""


class FileFormatError(SemlocError):
    """A scene-graph file (Hydra, spark_dsg) or a report's input can't be read."""


class LabelspaceError(SemlocError):
    """A labelspace is malformed, or two that must be equal are not."""


class ModelError(SemlocError):
    """A checkpoint can't be read, or an encoder is given what it was not made for."""


class TrainingError(SemlocError):
    """There is nothing to learn from, or a training state does not continue what it is given."""


class MapError(SemlocError):
    """A map database can't be read or written, or does not fit model or labelspace."""


class MapUnavailableError(MapError):
    """The server that keeps a map can't be reached in time; asking again later may help."""


class BagError(SemlocError):
    """A bag can't be read or written."""


class ConfigError(SemlocError):
    """An option or parameter is out of its range."""
