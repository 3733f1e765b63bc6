"""The site: links out of docs/ lead to what is there, nothing is fetched, and the reference has all that there is."""

import re
import sys
from types import SimpleNamespace

import pytest
from doc_blocks import ROOT

import semloc_core
from semloc_core.config import LocaliserConfig
from semloc_core.wire.messages import MESSAGES

sys.path.append(str(ROOT / "tools"))

import docs_reference


def page_of(address):
    return SimpleNamespace(file=SimpleNamespace(src_uri=address))


@pytest.fixture
def hook():
    pytest.importorskip("mkdocs", reason="the site's tools are not installed: make docs")
    import docs_pages

    return docs_pages


@pytest.mark.parametrize(
    ("link", "becomes"),
    [
        ("[code](../semloc_core/localiser.py)", "code"),
        ("[first](../README.md#inside)", "[first](index.md#inside)"),
        ("[schemas](../msgs_schema)", "[schemas](reference/messages.md)"),
        ("[page](trust.md)", "[page](trust.md)"),
        ("[away](https://milvus.io)", "[away](https://milvus.io)"),
    ],
)
def test_links_out_of_the_docs_are_led_to_what_the_site_has(hook, link, becomes) -> None:
    assert hook.on_page_markdown(f"a {link} b", page_of("ros.md"), None, None) == f"a {becomes} b"


def test_a_link_to_a_file_that_is_not_there_is_refused(hook) -> None:
    with pytest.raises(hook.PluginError, match="no_such_file"):
        hook.on_page_markdown("[a](../semloc_core/no_such_file.py)", page_of("ros.md"), None, None)


def test_a_page_that_would_fetch_something_is_refused(hook) -> None:
    assert hook.on_post_page('<a href="https://milvus.io">', page_of("ros.md"), None)
    for tag in ('<script src="https://unpkg.com/a">', '<link rel="stylesheet" href="//fonts.net/a.css">'):
        with pytest.raises(hook.PluginError, match="fetches"):
            hook.on_post_page(tag, page_of("ros.md"), None)


def test_the_reference_has_every_command_option_message_and_name() -> None:
    page = docs_reference.command_page()
    for path, command in docs_reference.commands():
        assert f"\n## {path}\n" in page
        for option in command.params:
            assert all(f"`{name}`" in page for name in option.opts if name.startswith("-")), (path, option.opts)
    assert re.findall(r"^## (\w+)$", docs_reference.python_page(), re.MULTILINE) == list(semloc_core.__all__)
    assert set(MESSAGES) <= set(re.findall(r"^## (\w+)$", docs_reference.message_page(), re.MULTILINE))


def test_parameters_are_those_of_the_localiser_and_of_every_node() -> None:
    page = docs_reference.parameter_page()
    listed = set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE))
    assert set(LocaliserConfig.__struct_fields__) <= listed
    for file in ("parameters.py", "player.py", "hydra_bridge.py", "detections_bridge.py"):
        text = (ROOT / "semloc_ros" / "semloc_ros" / file).read_text(encoding="utf-8")
        struct = re.search(r"class \w+Config\(.*?(?=\n\n\n)", text, re.DOTALL)
        assert struct, file
        assert set(re.findall(r"^    (\w+): ", struct[0], re.MULTILINE)) <= listed, file
