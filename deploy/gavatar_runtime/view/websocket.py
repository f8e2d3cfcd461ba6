"""The server's side of a WebSocket (RFC 6455), no more of it than the viewer's page needs."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import struct
from io import BufferedIOBase

GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
CONTINUATION, TEXT, BINARY, CLOSE, PING, PONG = 0x0, 0x1, 0x2, 0x8, 0x9, 0xA
PROTOCOL_ERROR, NOT_UTF8, TOO_BIG = 1002, 1007, 1009
NORMAL, UNEXPECTED = 1000, 1011
NEVER_SENT = (1004, 1005, 1006, 1015)  # codes that name what happened without a close frame


class Closed(Exception):
    """The connection is over. code: why, as the protocol numbers it."""

    def __init__(self, code: int, reason: str = ""):
        super().__init__(f"{code} {reason}".rstrip())
        self.code, self.reason = code, reason


def accept_key(key: str) -> str:
    """The answer to a client's `Sec-WebSocket-Key` (section 4.2.2). Raises ValueError for one that is no 16 bytes."""
    if len(base64.b64decode(key, validate=True)) != 16:
        raise ValueError("a WebSocket's key is 16 bytes")
    return base64.b64encode(hashlib.sha1((key + GUID).encode("ascii")).digest()).decode()


class WebSocket:
    """Messages over a stream whose handshake is done.

    reader, writer: unbuffered or buffered, of bytes. most: bytes that a message may have; text_most: one of text.
    """

    def __init__(self, reader: BufferedIOBase, writer: BufferedIOBase, most: int, text_most: int):
        self._reader, self._writer = reader, writer
        self.most, self.text_most = most, text_most
        self._ended = False

    def receive(self) -> str | bytes:
        """The next message, of text or of bytes; pings are answered meanwhile. Raises Closed when the other side ends
        the connection, and for whatever the protocol forbids, once that is said to the other side."""
        try:
            return self._receive()
        except Closed as closed:
            self.close(closed.code, closed.reason)
            raise
        except (OSError, ValueError) as error:  # a stream that was closed meanwhile is a ValueError
            self._ended = True
            raise Closed(1006, str(error)) from error

    def _receive(self) -> str | bytes:
        whole = bytearray()
        kind = 0
        while True:
            final, code, data = self._frame(len(whole), kind)
            if code == CLOSE:
                raise _good_bye(data)
            if code == PING:
                self._send(PONG, data)
                continue
            if code == PONG:
                continue
            if (code == CONTINUATION) != bool(kind):
                raise Closed(PROTOCOL_ERROR, "a message began within another")
            kind = kind or code
            whole += data
            if final:
                return bytes(whole) if kind == BINARY else _text(whole)

    def _frame(self, before: int, kind: int) -> tuple[bool, int, bytes]:
        """(last of its message, opcode, data) of the next frame of a message that has `before` bytes already."""
        first, second = self._exactly(2)
        code, length = first & 0x0F, second & 0x7F
        if first & 0x70 or code not in (CONTINUATION, TEXT, BINARY, CLOSE, PING, PONG):
            raise Closed(PROTOCOL_ERROR, "unknown kind of frame")
        if not second & 0x80:
            raise Closed(PROTOCOL_ERROR, "a client's frames are masked")
        if code >= CLOSE and (length > 125 or not first & 0x80):
            raise Closed(PROTOCOL_ERROR, "a control frame is short and whole")
        if length == 126:
            (length,) = struct.unpack(">H", self._exactly(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._exactly(8))
        if code < CLOSE and length + before > (self.text_most if TEXT in (code, kind) else self.most):
            raise Closed(TOO_BIG, "message too big")
        mask = self._exactly(4)
        return bool(first & 0x80), code, _unmasked(self._exactly(length), mask)

    def _exactly(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count:
            part = self._reader.read(min(count - len(data), 1 << 20))
            if not part:
                raise Closed(1006, "the connection ended within a frame" if data else "the connection ended")
            data += part
        return bytes(data)

    def send_text(self, text: str) -> None:
        """Raises Closed if the other side is gone."""
        self._send(TEXT, text.encode("utf-8"))

    def send_bytes(self, *parts: bytes | memoryview) -> None:
        """One message of all the parts. Raises Closed if the other side is gone."""
        self._send(BINARY, *parts)

    def close(self, code: int = NORMAL, reason: str = "") -> None:
        """Say good-bye; harmless twice, and where the other side is gone."""
        if self._ended:
            return
        sent = NORMAL if code in NEVER_SENT else code
        with contextlib.suppress(Closed):
            self._send(CLOSE, struct.pack(">H", sent) + reason.encode()[:120].decode(errors="ignore").encode())
        self._ended = True

    def _send(self, code: int, *parts: bytes | memoryview) -> None:
        if self._ended:
            raise Closed(1006, "the connection ended")
        length = sum(len(part) for part in parts)
        if length < 126:
            head = struct.pack(">BB", 0x80 | code, length)
        elif length < 1 << 16:
            head = struct.pack(">BBH", 0x80 | code, 126, length)
        else:
            head = struct.pack(">BBQ", 0x80 | code, 127, length)
        try:
            self._writer.write(head)
            for part in parts:
                self._writer.write(part)
            self._writer.flush()
        except (OSError, ValueError) as error:
            self._ended = True
            raise Closed(1006, str(error)) from error


def _text(data: bytes | bytearray) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise Closed(NOT_UTF8, "text that is not UTF-8") from None


def _good_bye(data: bytes) -> Closed:
    """What a close frame says (section 5.5.1)."""
    if not data:
        return Closed(NORMAL)
    code = int.from_bytes(data[:2], "big")
    if len(data) == 1 or code not in range(1000, 5000) or code in NEVER_SENT:
        return Closed(PROTOCOL_ERROR, "no reason to close")
    return Closed(code, _text(data[2:]))


def _unmasked(data: bytes, mask: bytes) -> bytes:
    """data xor mask, repeated; as one big number, which is many times faster than byte by byte."""
    if not data:
        return data
    repeated = (mask * (len(data) // 4 + 1))[: len(data)]
    return (int.from_bytes(data, "big") ^ int.from_bytes(repeated, "big")).to_bytes(len(data), "big")
