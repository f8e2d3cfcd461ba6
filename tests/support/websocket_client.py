"""A WebSocket client that may misbehave: frames byte by byte, for tests of the viewer's server."""

from __future__ import annotations

import base64
import json
import socket
import struct
import urllib.parse
from typing import Any

from gavatar_runtime.view.server import Viewer

KEY = base64.b64encode(b"0123456789abcdef").decode()


def frame(code: int, data: bytes = b"", *, final: bool = True, masked: bool = True, reserved: int = 0) -> bytes:
    """One frame as a client sends it (RFC 6455, section 5.2)."""
    head = bytes([(0x80 if final else 0) | reserved | code])
    bit = 0x80 if masked else 0
    if len(data) < 126:
        head += bytes([bit | len(data)])
    elif len(data) < 1 << 16:
        head += bytes([bit | 126]) + struct.pack(">H", len(data))
    else:
        head += bytes([bit | 127]) + struct.pack(">Q", len(data))
    if not masked:
        return head + data
    mask = b"\x11\x22\x33\x44"
    return head + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(data))


def request(
    viewer: Viewer, path: str | None = None, **headers: str | None
) -> tuple[int, dict[str, str], bytes, socket.socket]:
    """Status, headers, the first of the body and the socket of a GET; the page's own headers but for those given, with
    `_` for `-`; None leaves one out."""
    parsed = urllib.parse.urlsplit(viewer.address)
    said: dict[str, str | None] = {
        "Host": parsed.netloc, "Origin": f"http://{parsed.netloc}", "Upgrade": "websocket", "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": KEY,
    }  # fmt: skip
    said |= {name.replace("_", "-"): value for name, value in headers.items()}
    path = f"/socket?token={viewer.token}" if path is None else path
    text = f"GET {path} HTTP/1.1\r\n" + "".join(f"{k}: {v}\r\n" for k, v in said.items() if v is not None) + "\r\n"
    connection = socket.create_connection(("127.0.0.1", viewer.port), timeout=20)
    connection.sendall(text.encode("latin-1"))
    data = b""
    while b"\r\n\r\n" not in data:
        data += connection.recv(1 << 16) or b"\r\n\r\n"
    head, _, rest = data.partition(b"\r\n\r\n")
    lines = head.decode("latin-1").split("\r\n")
    status = int(lines[0].split()[1]) if lines[0] else 0
    return status, {k.lower(): v for k, v in (line.split(": ", 1) for line in lines[1:])}, rest, connection


class Client:
    """A connection to a viewer whose handshake is done."""

    def __init__(self, viewer: Viewer):
        status, self.headers, self._data, self.socket = request(viewer)
        assert status == 101
        self.number = 0

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception: object) -> None:
        self.socket.close()

    def send(self, data: bytes) -> None:
        """Bytes as they are."""
        self.socket.sendall(data)

    def receive(self) -> tuple[int, bytes]:
        """(opcode, data) of the next frame; (-1, b'') where the server has hung up."""
        head = self._exactly(2)
        if head is None:
            return -1, b""
        assert (head[0] & 0x80, head[1] & 0x80) == (0x80, 0), "a server's frames here are whole and not masked"
        length = head[1]
        if length > 125:
            length = int.from_bytes(self._exactly(2 if length == 126 else 8) or b"", "big")
        return head[0] & 0x0F, self._exactly(length) or b""

    def _exactly(self, count: int) -> bytes | None:
        while len(self._data) < count:
            try:
                part = self.socket.recv(1 << 20)
            except ConnectionResetError:
                part = b""
            if not part:
                return None
            self._data += part
        out, self._data = self._data[:count], self._data[count:]
        return out

    def ask(self, **message: Any) -> dict[str, Any]:
        """The answer to a message, as JSON."""
        self.number += 1
        self.send(frame(1, json.dumps({"id": self.number, **message}).encode()))
        code, data = self.receive()
        assert code == 1
        answer = json.loads(data)
        assert answer.pop("id") == self.number
        return answer

    def ask_frame(self, **wish: Any) -> tuple[dict[str, Any], bytes]:
        """Head and bytes of the frame that a wish makes."""
        self.number += 1
        self.send(frame(1, json.dumps({"id": self.number, "do": "draw", **wish}).encode()))
        code, data = self.receive()
        assert code == 2, data
        end = 4 + int.from_bytes(data[:4], "little")
        return json.loads(data[4:end]), data[end:]

    def send_file(self, name: Any, data: bytes) -> dict[str, Any]:
        """The answer to a motion file."""
        self.number += 1
        head = json.dumps({"id": self.number, "name": name}).encode()
        self.send(frame(2, len(head).to_bytes(4, "little") + head + data))
        code, answer = self.receive()
        assert code == 1
        return json.loads(answer)

    def closed_with(self) -> int | None:
        """The code that the server closes with once what it sent before is read; None where it just hangs up."""
        while True:
            code, data = self.receive()
            if code == 8:
                return int.from_bytes(data[:2], "big")
            if code < 0:
                return None
