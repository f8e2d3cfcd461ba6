"""The page's text: whole, of one piece, and reaching for nothing elsewhere."""

from __future__ import annotations

import base64
import json
import re

import pytest

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.view.page import viewer_page
from gavatar_runtime.web.look import read_look
from gavatar_runtime.web.page import PUBLIC, folder_page, module, single_page
from gavatar_runtime.web.web_data import pack

ADDRESS = re.compile(r"""(?:https?:)?//[\w.-]+\.\w+|\bimport\s*\(""")


@pytest.fixture(scope="module")
def packed(static):
    return pack(read_look(Avatar(read_bundle(static), tier=None)), ())


def test_no_page_asks_another_host(packed):
    for text in (single_page(packed).decode(), folder_page().decode(), viewer_page().decode(), module()):
        plain = re.sub(r"(?m)//[^\n]*$|base64,[\w+/=]*", "", text)
        assert not re.findall(r"""(?:src|href)\s*=\s*["'](?!data:)""", plain)
        assert not ADDRESS.findall(plain)


def test_the_policy_lets_nothing_else_in(packed):
    for text in (single_page(packed).decode(), viewer_page().decode()):
        (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
        assert policy.startswith("default-src 'none'")
        assert "http" not in policy
        assert "*" not in policy


def test_one_scope_has_no_imports_and_no_name_twice():
    text = module()
    assert not re.findall(r"(?m)^import\b", text)
    assert len(re.findall(r"(?m)^export\b", text)) == 1
    names = re.findall(r"(?m)^(?:async )?(?:function|class|const|let) (\w+)", text)
    assert len(names) == len(set(names))
    assert set(PUBLIC) <= set(names)


def test_the_single_page_holds_every_block_in_order(packed):
    text = single_page(packed).decode()
    found = re.findall(r'<script type="text/plain" id="block(\d+)">([^<]*)</script>', text)
    assert [int(k) for k, _ in found] == list(range(len(packed.blocks)))
    assert [base64.b64decode(data) for _, data in found] == list(packed.blocks)


def test_names_of_people_stay_text():
    """A name with markup in it ends no script and opens no element."""
    from gavatar_runtime.web.web_data import Packed

    name = "</script><script>alert(1)</script><!--"
    text = single_page(Packed({"name": name, "blocks": []}, ())).decode()
    assert name not in text
    (header,) = re.findall(r"gavatar\.pageSource\((\{.*\})\);", text)
    assert json.loads(header)["name"] == name
