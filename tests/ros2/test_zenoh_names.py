"""Keys, tokens and attachments are those of rmw_zenoh, as others read them.

The strings were made by zenoh-ros2-sdk 0.1.8; `test_zenoh` runs it, and pamoja-ros2, again.
"""

from __future__ import annotations

from armadico.bridge.ros2 import zenoh_names as names
from armadico.bridge.ros2.frames import Wanted
from armadico.bridge.ros2.graph import Endpoint

STRING = "std_msgs/msg/String"
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
MEMBER = names.Member(7, "abc123", "tb1", "armadico")
TALK = Wanted("talk", STRING, writes=True, depth=10)


def test_a_samples_key() -> None:
    key = f"7/tb1/talk/std_msgs::msg::dds_::String_/{HASH}"
    assert names.key(7, "/tb1/talk", STRING) == key


def test_tokens() -> None:
    assert MEMBER.token() == "@ros2_lv/7/abc123/0/0/NN/%/%tb1/armadico"
    bare = names.Member(7, "abc123", "", "armadico")
    assert bare.token() == "@ros2_lv/7/abc123/0/0/NN/%/%/armadico"
    token = MEMBER.endpoint(3, "/tb1/talk", STRING, TALK)
    head = "@ros2_lv/7/abc123/0/3/MP/%/%tb1/armadico/%tb1%talk/std_msgs::msg::dds_::String_"
    assert token == f"{head}/{HASH}/1:2:1,10:,:,:,,"
    quiet = Wanted("talk", STRING, reliable=False, latched=True, depth=5)
    token = MEMBER.endpoint(4, "/tb1/talk", STRING, quiet)
    assert token.endswith("/2:1:1,5:,:,:,,")
    assert "/0/4/MS/" in token


def test_an_attachment() -> None:
    attachment = names.attachment(5, 1234567890123, bytes(range(16)))
    assert attachment.hex() == "0500000000000000cb04fb711f01000010000102030405060708090a0b0c0d0e0f"


def test_an_endpoint_is_read_from_its_token() -> None:
    token = MEMBER.endpoint(3, "/tb1/talk", STRING, TALK)
    assert names.endpoint(token) == Endpoint("/tb1/talk", STRING, "/tb1/armadico", True, True, True)
    assert names.session(token) == "abc123"
    reads = names.endpoint(token.replace("/MP/", "/MS/").replace("%tb1/armadico", "%/armadico"))
    assert reads == Endpoint("/tb1/talk", STRING, "/armadico", False, False, False)


def test_what_is_no_endpoints_token() -> None:
    for token in (MEMBER.token(), "", "@ros2_lv", "a/b/c/d/e/f/g/h/i/j/k/l/m", "@ros2_lv/" * 14):
        assert names.endpoint(token) is None
    assert names.session("x/y") == ""
