"""The viewer's server: the page over HTTP and frames over a WebSocket, on this machine alone unless asked.

What it lets in: requests with its token, that name it by an address it is bound to (so that no other site's name can
be made to point at it), and WebSockets that its own page opened. It serves the page and what the scene draws; no path
of a request ever becomes one of a file.
"""

from __future__ import annotations

import contextlib
import hmac
import http.server
import json
import secrets
import socket
import struct
import threading
import urllib.parse
import weakref
from time import perf_counter
from typing import Any

from ..errors import UserError, WrongValue
from .drive import LIVE
from .frame_encoding import encoded, exact
from .page import viewer_page
from .viewed_avatar import MOST, ViewedAvatar, Wish
from .websocket import UNEXPECTED, Closed, WebSocket, accept_key

LOOPBACK = "127.0.0.1"
NAMES = ("127.0.0.1", "localhost", "[::1]")  # of the loopback address, which a browser may call it by
EVERY = ("", "0.0.0.0", "::")  # address of this machine
TEXT_MOST, MOST_BYTES = 1 << 16, 1 << 26  # of a message: wishes, and motion files
IDLE = 3600  # seconds after which a connection without a word is closed
CONNECTIONS = 16
POLICY = 1008  # a close code: the message is none that this server takes


class Viewer:
    """A server that is running, in threads of its own.

    scene: what is drawn. host: the address to listen on; port: 0 for any that is free. Raises UserError where that
    address cannot be had.
    """

    def __init__(self, scene: ViewedAvatar, host: str = LOOPBACK, port: int = 0):
        self.scene = scene
        self.host = host
        try:
            server = _Server((host, port), scene)
        except (OSError, OverflowError) as error:
            raise UserError(f"cannot listen on {host}:{port}: {error}") from None
        self.port, self.token = int(server.server_address[1]), server.token
        threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True).start()
        self._end = weakref.finalize(self, server.end)

    @property
    def address(self) -> str:
        """Where a browser finds the page, token included."""
        host = socket.gethostname() if self.host in EVERY else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/?token={self.token}"

    def close(self) -> None:
        """End the server and its connections, as happens when this object is gone."""
        self._end()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        """In a notebook: the page in a frame."""
        return (
            f'<iframe src="{self.address}" width="100%" height="640" style="border: 0" '
            'allow="clipboard-write; fullscreen; camera"></iframe>'
        )


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 32

    def __init__(self, address: tuple[str, int], scene: ViewedAvatar):
        self.host, self.scene = address[0], scene
        self.token = secrets.token_urlsafe(16)
        self.open: set[socket.socket] = set()
        self.lock = threading.Lock()
        if ":" in address[0]:
            self.address_family = socket.AF_INET6
        super().__init__(address, _Handler)

    def take(self, connection: socket.socket) -> bool:
        """Count a connection that stays; False where there are too many already."""
        with self.lock:
            if len(self.open) >= CONNECTIONS:
                return False
            self.open.add(connection)
            return True

    def leave(self, connection: socket.socket) -> None:
        """Count it no longer."""
        with self.lock:
            self.open.discard(connection)

    def allows(self, host: str) -> bool:
        """Whether a request may call the server so: by a name of the loopback address, or the address it is bound to,
        or any where it is bound to all, where the token alone guards. The port may be another: ssh forwards some."""
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        return name in (*NAMES, self.host, f"[{self.host}]") or self.host in EVERY

    def end(self) -> None:
        """End the server and all connections that stay."""
        self.shutdown()
        self.server_close()
        with self.lock:
            for connection in self.open:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that is gone is nobody's fault; anything else is a bug and keeps its traceback."""
        import sys

        if not isinstance(sys.exc_info()[1], (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


class _Handler(http.server.BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "gavatar", ""
    timeout = 30

    def do_GET(self) -> None:
        parsed = urllib.parse.urlsplit(self.path)
        if not self.server.allows(self.headers.get("Host", "")):
            self._refuse(403, "this address is not the viewer's own")
        elif parsed.path not in ("/", "/socket"):
            self._refuse(404, "nothing here")
        elif not self._has_token(parsed.query):
            self._refuse(403, "the address lacks the viewer's token: open the one that gavatar-view printed")
        elif parsed.path == "/":
            self._send(200, viewer_page(), "text/html; charset=utf-8")
        else:
            self._socket()

    def _has_token(self, query: str) -> bool:
        given = urllib.parse.parse_qs(query, max_num_fields=8).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), self.server.token.encode())

    def _socket(self) -> None:
        origin = urllib.parse.urlsplit(self.headers.get("Origin", ""))
        if origin.scheme != "http" or origin.netloc != self.headers.get("Host"):
            self._refuse(403, "only the viewer's own page may connect")
            return
        try:
            asked = self.headers.get("Upgrade", "").lower(), self.headers.get("Sec-WebSocket-Version")
            if asked != ("websocket", "13") or "upgrade" not in self.headers.get("Connection", "").lower():
                raise ValueError("no WebSocket of version 13")
            answer = accept_key(self.headers["Sec-WebSocket-Key"] or "")
        except ValueError:
            self._refuse(400, "this address is for WebSockets")
            return
        if not self.server.take(self.connection):
            self._refuse(503, f"{CONNECTIONS} pages are open already: close some")
            return
        try:
            self.send_response(101)
            for name, value in (("Upgrade", "websocket"), ("Connection", "Upgrade"), ("Sec-WebSocket-Accept", answer)):
                self.send_header(name, value)
            self.end_headers()
            self.close_connection = True
            self.connection.settimeout(IDLE)
            self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            serve(WebSocket(self.rfile, self.wfile, MOST_BYTES, TEXT_MOST), self.server.scene)
        finally:
            self.server.leave(self.connection)

    def _refuse(self, status: int, sentence: str) -> None:
        self.close_connection = True
        self._send(status, (sentence + "\n").encode(), "text/plain; charset=utf-8")

    def _send(self, status: int, data: bytes, kind: str) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind, "Content-Length": str(len(data)), "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
        }  # fmt: skip
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *arguments: Any) -> None:
        """A viewer keeps no log of requests."""


def serve(connection: WebSocket, scene: ViewedAvatar) -> None:
    """Answer the page's messages until it leaves. A message that is none of ours ends the connection."""
    try:
        while True:
            message = connection.receive()
            try:
                if isinstance(message, str):
                    _answer(connection, scene, _object(message))
                else:
                    _take_file(connection, scene, message)
            except _Malformed as error:
                connection.close(POLICY, str(error))
                return
            except Closed:
                raise
            except BaseException:  # a fault of ours: the page is told before its traceback is
                connection.close(UNEXPECTED, "gavatar-view failed: its window tells more")
                raise
    except Closed:
        return


class _Malformed(Exception):
    """No message that the page sends."""


def _object(text: str) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise _Malformed("no JSON") from None
    if not isinstance(message, dict) or not isinstance(message.get("id"), int):
        raise _Malformed("no message")
    return message


def _answer(connection: WebSocket, scene: ViewedAvatar, message: dict[str, Any]) -> None:
    doing, number = message.get("do"), message["id"]
    try:
        if doing == "draw":
            _send_frame(connection, scene, message)
            return
        if doing == "hello":
            result = _hello(scene)
        elif doing == "motion":
            name = message.get("name")
            result = scene.described(name if isinstance(name, str) else "")
        else:
            raise _Malformed("an unknown message")
        connection.send_text(json.dumps({"id": number, **result}))
    except UserError as error:
        connection.send_text(json.dumps({"id": number, "error": str(error)}))


def _hello(scene: ViewedAvatar) -> dict[str, Any]:
    bundle = scene.bundle
    return {
        "name": bundle.manifest.name, "path": str(bundle.path), "gaussians": bundle.manifest.gaussians,
        "first": scene.gaussians,
        "tiers": scene.tiers, "tier": scene.tier, "motions": scene.motion_names, "most": MOST,
        "drive": None if scene.drive is None else scene.drive.told(),
    }  # fmt: skip


def _send_frame(connection: WebSocket, scene: ViewedAvatar, message: dict[str, Any]) -> None:
    wish = Wish.of(message)
    live: dict[str, Any] | None = None
    beside: bytes | memoryview = b""
    if scene.drive is not None and wish.motion == LIVE:
        shown = scene.drive.next(connection)
        pose, trans = scene.drive.rest if shown is None else (shown.pose, shown.trans)
        image, stages, count = scene.draw_pose(wish, pose, trans)
        stages = stages if shown is None else {"follow": 1000 * shown.seconds, **stages}
        live, beside = scene.drive.beside(shown)
    else:
        image, stages, count = scene.draw(wish)
    begun = perf_counter()
    kind, data = exact(image) if message.get("exact") is True else encoded(image)
    stages["picture"] = 1000 * (perf_counter() - begun)
    head = {
        "id": message["id"], "kind": kind, "width": image.shape[1], "height": image.shape[0], "gaussians": count,
        "stages": {name: round(ms, 2) for name, ms in stages.items()}, **({} if live is None else {"live": live}),
    }  # fmt: skip
    text = json.dumps(head).encode()
    connection.send_bytes(struct.pack("<I", len(text)), text, data, beside)


def _take_file(connection: WebSocket, scene: ViewedAvatar, data: bytes) -> None:
    """The length of a header as four bytes, the header, and a motion file, {id, name}, or a picture of the page's
    camera, {id, do: "camera"}."""
    length = int.from_bytes(data[:4], "little")
    if len(data) < 4 or length > 4096 or 4 + length > len(data):
        raise _Malformed("no file")
    try:
        head = _object(data[4 : 4 + length].decode("utf-8"))
    except UnicodeDecodeError:
        raise _Malformed("no file") from None
    try:
        if head.get("do") == "camera":
            if scene.drive is None:
                raise WrongValue("this viewer cannot be driven by a camera")
            scene.drive.take(connection, data[4 + length :], head["id"])
            connection.send_text(json.dumps({"id": head["id"]}))
            return
        if not isinstance(head.get("name"), str):
            raise WrongValue("the file has no name")
        name, notes = scene.add_file(head["name"], data[4 + length :])
        connection.send_text(json.dumps({"id": head["id"], "name": name, "notes": notes}))
    except UserError as error:
        connection.send_text(json.dumps({"id": head["id"], "error": str(error)}))
