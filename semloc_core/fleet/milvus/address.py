"""Addresses of maps that a server keeps: ``milvus+http://host:port/name``, with TLS ``milvus+https://…``.

A token is never part of an address, which ends up in logs, launch files and shell histories: it is read from the
environment, `TOKEN_VARIABLE`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import urlsplit

from semloc_core.errors import MapError

TOKEN_VARIABLE = "SEMLOC_MILVUS_TOKEN"
CERTIFICATE_VARIABLE = "SEMLOC_MILVUS_CA"
DEFAULT_PORT = 19530
_SCHEMES = ("milvus+http", "milvus+https")
_NAME = re.compile(r"[A-Za-z0-9_]{1,64}")


@dataclass(frozen=True)
class MilvusAddress:
    """Where a map is kept.

    Args:
        host: name or IPv4 number of the server.
        port: of the server.
        name: the map's.
        secure: whether to use TLS.

    """

    host: str
    port: int
    name: str
    secure: bool = False

    @property
    def uri(self) -> str:
        """The server, as pymilvus wants it."""
        return f"http{'s' if self.secure else ''}://{self.host}:{self.port}"

    def __str__(self) -> str:
        return f"milvus+{self.uri}/{self.name}"


def is_address(text: str) -> bool:
    """Whether a text means a map on a server rather than a file: it starts as an address does, well-formed or not."""
    return text.lower().startswith("milvus+")


def parse_address(text: str) -> MilvusAddress:
    """Read an address.

    Raises:
        MapError: it is none, or holds more than an address may. What could be a password is not repeated.

    """
    wanted = "expected an address milvus+http://host:port/name"
    if not text.isprintable() or " " in text:
        raise MapError(f"{wanted} (got spaces or what can't be printed)")
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise MapError(f"{wanted} (got one whose host or port can't be read)") from None
    if parts.scheme not in _SCHEMES:
        raise MapError(f"{wanted} or milvus+https://… (got scheme {parts.scheme[:40]!r})")
    if parts.username is not None or parts.password is not None:
        raise MapError(f"{wanted} without user or token (got one with; put the token into {TOKEN_VARIABLE})")
    if not host:
        raise MapError(f"{wanted} (got no host: {text})")
    if ":" in host:
        raise MapError(f"{wanted}, a host's name or IPv4 number (got an IPv6 number, which pymilvus does not take)")
    if parts.query or parts.fragment:
        raise MapError(f"{wanted} and no more (got something after the name)")
    name = parts.path.removeprefix("/").removesuffix("/")
    if not _NAME.fullmatch(name):
        raise MapError(f"{wanted}, a name of 1 to 64 letters, digits and underscores (got {name[:80]!r})")
    return MilvusAddress(host, port if port is not None else DEFAULT_PORT, name, parts.scheme.endswith("s"))
