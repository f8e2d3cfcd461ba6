"""RFC 6455 from the server's side: what it takes, what it answers, and with which code it ends the rest."""

from __future__ import annotations

import io
import struct

import pytest
from websocket_client import frame

from gavatar_runtime.view.websocket import Closed, WebSocket, accept_key

TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10


def opened(*frames: bytes, most: int = 1000, text_most: int = 100) -> tuple[WebSocket, io.BytesIO]:
    written = io.BytesIO()
    return WebSocket(io.BytesIO(b"".join(frames)), written, most, text_most), written


def ended(*frames: bytes, **bounds: int) -> tuple[int, bytes]:
    """The code that frames end the connection with, and what was written."""
    connection, written = opened(*frames, **bounds)
    try:
        while True:
            connection.receive()
    except Closed as closed:
        return closed.code, written.getvalue()


def test_the_handshake_of_the_standards_example():
    assert accept_key("dGhlIHNhbXBsZSBub25jZQ==") == "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="  # section 1.3


@pytest.mark.parametrize("key", ["", "short", "AAAA", "!!!!", "dGhlIHNhbXBsZSBub25jZQ==x"])
def test_other_keys_are_refused(key):
    with pytest.raises(ValueError):  # noqa: PT011 (binascii words it)
        accept_key(key)


def test_frames_of_the_standards_examples():
    masked = bytes([0x81, 0x85, 0x37, 0xFA, 0x21, 0x3D, 0x7F, 0x9F, 0x4D, 0x51, 0x58])  # section 5.7
    connection, written = opened(masked)
    assert connection.receive() == "Hello"
    connection.send_text("Hello")
    assert written.getvalue() == bytes([0x81, 0x05, 0x48, 0x65, 0x6C, 0x6C, 0x6F])


@pytest.mark.parametrize("size", [0, 1, 3, 125, 126, 127, 65535, 65536, 100001])
def test_messages_of_any_length(size):
    data = bytes(i * 7 % 256 for i in range(size))
    connection, written = opened(frame(BINARY, data), most=1 << 20)
    assert connection.receive() == data
    connection.send_bytes(data[: size // 2], data[size // 2 :])
    sent = written.getvalue()
    head = 2 if size < 126 else 4 if size < 65536 else 10
    assert sent[head:] == data
    assert not sent[1] & 0x80


def test_fragments_join_and_control_frames_come_between():
    whole = "grüße".encode()
    parts = frame(TEXT, whole[:3], final=False), frame(PING, b"?"), frame(0, b"", final=False), frame(0, whole[3:])
    connection, written = opened(*parts, frame(PONG, b"late"), frame(TEXT, b"next"))
    assert connection.receive() == "grüße"  # though the cut goes through a letter
    assert connection.receive() == "next"
    assert written.getvalue() == b"\x8a\x01?"


def test_a_ping_does_not_count_towards_the_message():
    parts = frame(TEXT, b"a" * 100, final=False), frame(PING, b"b" * 125), frame(0, b"")
    assert opened(*parts)[0].receive() == "a" * 100


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([frame(TEXT, b"x", masked=False)], 1002),
        ([frame(TEXT, b"x", reserved=0x40)], 1002),
        ([frame(TEXT, b"x", reserved=0x10)], 1002),
        ([frame(3, b"x")], 1002),
        ([frame(0xB, b"x")], 1002),
        ([frame(0, b"x")], 1002),  # goes on with nothing
        ([frame(TEXT, b"x", final=False), frame(TEXT, b"y")], 1002),
        ([frame(BINARY, b"", final=False), frame(BINARY, b"y")], 1002),
        ([frame(PING, b"x" * 126)], 1002),
        ([frame(PING, b"x", final=False)], 1002),
        ([frame(CLOSE, b"x", final=False)], 1002),
        ([frame(TEXT, b"\xff\xfe")], 1007),
        ([frame(TEXT, b"\xc3", final=False), frame(0, b"(")], 1007),
        ([frame(TEXT, b"x" * 101)], 1009),
        ([frame(TEXT, b"x" * 60, final=False), frame(0, b"x" * 60)], 1009),
        ([frame(BINARY, b"x" * 1001)], 1009),
        ([b"\x82\xff" + struct.pack(">Q", 1 << 63)], 1009),
        ([b"\x82\xff" + struct.pack(">Q", (1 << 64) - 1)], 1009),
        ([frame(CLOSE, b"\x03")], 1002),
        ([frame(CLOSE, struct.pack(">H", 999))], 1002),
        ([frame(CLOSE, struct.pack(">H", 1005))], 1002),
        ([frame(CLOSE, struct.pack(">H", 5000))], 1002),
        ([frame(CLOSE, struct.pack(">H", 1000) + b"\xff")], 1007),
    ],
)  # fmt: skip
def test_what_the_protocol_forbids_ends_the_connection(frames, code):
    got, written = ended(*frames)
    assert got == code
    assert written[:1] == b"\x88"
    assert int.from_bytes(written[2:4], "big") == code
    assert written.count(b"\x88") == 1 or len(written) == 2 + written[1]  # said once


def test_a_good_bye_is_answered_with_its_code():
    assert ended(frame(CLOSE, struct.pack(">H", 1001) + b"bye")) == (1001, b"\x88\x05\x03\xe9bye")
    assert ended(frame(CLOSE)) == (1000, b"\x88\x02\x03\xe8")


@pytest.mark.parametrize("cut", range(1, len(frame(BINARY, b"x" * 200))))
def test_a_line_that_breaks_anywhere_is_an_end(cut):
    assert ended(frame(BINARY, b"x" * 200)[:cut])[0] == 1006


def test_after_the_end_nothing_is_sent():
    connection, written = opened()
    connection.close(1008, "ü" * 100)  # longer than a control frame may be, and its cut goes through a letter
    length = len(written.getvalue())
    assert length <= 127
    assert written.getvalue()[4:].decode()
    connection.close(1000)
    with pytest.raises(Closed):
        connection.send_text("more")
    assert len(written.getvalue()) == length
