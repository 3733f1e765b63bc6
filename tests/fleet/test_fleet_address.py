"""Addresses: what is one, what is not, and that nothing secret is repeated."""

import subprocess
import sys

import pytest

from semloc_core.errors import MapError
from semloc_core.fleet.milvus.address import MilvusAddress, is_address, parse_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("milvus+http://localhost:19530/hq", MilvusAddress("localhost", 19530, "hq")),
        ("milvus+https://maps.example.org/Site_2", MilvusAddress("maps.example.org", 19530, "Site_2", True)),
        ("milvus+http://127.0.0.1:7/x/", MilvusAddress("127.0.0.1", 7, "x")),
        ("MILVUS+HTTP://10.0.0.1:1/x", MilvusAddress("10.0.0.1", 1, "x")),
    ],
)
def test_addresses(text: str, address: MilvusAddress) -> None:
    assert is_address(text)
    assert parse_address(text) == address
    assert parse_address(str(address)) == address


def test_uri_has_the_scheme_of_the_server() -> None:
    assert parse_address("milvus+https://h:1/x").uri == "https://h:1"
    assert parse_address("milvus+http://h/x").uri == "http://h:19530"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("milvus+http://host:1/", "1 to 64 letters, digits and underscores"),
        ("milvus+http://host:1/a-b", "letters, digits and underscores"),
        ("milvus+http://host:1/a/b", "letters, digits and underscores"),
        ("milvus+http://host:1/ä", "letters, digits and underscores"),
        ("milvus+http://host:1/" + "x" * 65, "letters, digits and underscores"),
        ("milvus+http://[::1]:7/x", "an IPv6 number"),
        ("milvus+http:///x", "got no host"),
        ("milvus+http:/host/x", "got no host"),
        ("milvus+http://host:port/x", "host or port can't be read"),
        ("milvus+http://host:99999/x", "host or port can't be read"),
        ("milvus+http://[::1/x", "host or port can't be read"),
        ("milvus+ftp://host:1/x", "scheme 'milvus\\+ftp'"),
        ("milvus+http://host:1/x?token=hush", "something after the name"),
        ("milvus+http://root:hush@host:1/x", "SEMLOC_MILVUS_TOKEN"),
        ("milvus+http://hush@host:1/x", "SEMLOC_MILVUS_TOKEN"),
        ("milvus+http://host:1/x y", "spaces"),
        ("milvus+http://host:1/x\n", "can't be printed"),
    ],
)
def test_what_is_none(text: str, message: str) -> None:
    assert is_address(text)
    with pytest.raises(MapError, match=message) as caught:
        parse_address(text)
    assert "hush" not in str(caught.value)


@pytest.mark.parametrize("text", ["office.map", "/tmp/milvus+http.map", "http://host:1/x", "./milvus+http:", ""])
def test_files_are_no_addresses(text: str) -> None:
    assert not is_address(text)


def test_pymilvus_is_not_imported_before_a_server_is_asked() -> None:
    """It would cost who uses map files half a second and a hundred megabytes."""
    fleet = "semloc_core.fleet."
    modules = f"{fleet}open_map, {fleet}milvus.source, {fleet}writing.database, semloc_core.cli"
    check = "sorted({'pymilvus', 'grpc', 'pandas'} & sys.modules.keys())"
    code = f"import sys, {modules}; print({check})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_without_pymilvus_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from semloc_core.fleet.milvus.source import MilvusSource

    monkeypatch.setitem(sys.modules, "pymilvus", None)
    with pytest.raises(MapError, match=r"got no pymilvus: pip install -e '.\[fleet\]' in the clone"):
        MilvusSource(parse_address("milvus+http://localhost:1/x")).catalogue()
