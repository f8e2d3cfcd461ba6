"""The viewer's server: whom it lets in, what it answers; whatever a page sends ends no more than its connection."""

from __future__ import annotations

import json
import socket
import threading

import numpy as np
import pytest
from websocket_client import Client, frame, request

from gavatar_runtime import native_library
from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.view.page import viewer_page
from gavatar_runtime.view.server import CONNECTIONS, Viewer
from gavatar_runtime.view.viewed_avatar import ViewedAvatar

VIEW = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 3]
CAMERA = {"view": VIEW, "fx": 80, "fy": 80, "cx": 32, "cy": 24}
WISH = {"motion": "turn", "time": 0.5, "camera": CAMERA, "background": [0.2, 0.5, 1], "width": 64, "height": 48,
        "tier": "full", "gaussians": None}  # fmt: skip

needs_kernel = pytest.mark.skipif(not native_library.available()[0], reason="the kernel writes JPEG")


@pytest.fixture(scope="module")
def viewer(static):
    with Viewer(ViewedAvatar(read_bundle(static))) as made:
        yield made


def still_answers(viewer) -> None:
    with Client(viewer) as other:
        assert other.ask(do="hello")["name"] == "tester"


def status(viewer, path=None, **headers) -> int:
    got, _, _, connection = request(viewer, path, **headers)
    connection.close()
    return got


def test_the_page_is_served_to_its_address(viewer):
    code, headers, _, connection = request(viewer, f"/?token={viewer.token}")
    connection.close()
    assert code == 200
    assert int(headers["content-length"]) == len(viewer_page())
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cache-control"] == "no-store"


def test_nobody_without_the_token(viewer):
    for path in (
        "/",
        "/?token=",
        f"/?token={viewer.token}x",
        "/?tok=1",
        "/socket",
        "/socket?token=no",
        "/?token=%FF%00",
    ):
        assert status(viewer, path) == 403, path


def test_nobody_by_another_name(viewer):
    """A page of another site whose name was made to point here sends that name."""
    for host in ("evil.example", f"evil.example:{viewer.port}", "", None, "127.0.0.1.evil.example", "[::2]", "0.0.0.0"):
        assert status(viewer, f"/?token={viewer.token}", Host=host) == 403, host
        assert status(viewer, Host=host, Origin=f"http://{host}") == 403, host


def test_a_forwarded_port_is_no_other_name(viewer):
    for host in ("localhost:9999", "127.0.0.1:8000", "[::1]:80", "localhost"):
        assert status(viewer, f"/?token={viewer.token}", Host=host) == 200, host


def test_only_its_own_page_may_connect(viewer):
    own = f"127.0.0.1:{viewer.port}"
    for origin in (
        None,
        "",
        "null",
        "http://evil.example",
        f"https://{own}",
        "http://127.0.0.1:1",
        f"http://{own}.evil",
    ):
        assert status(viewer, Origin=origin) == 403, origin


@pytest.mark.parametrize(
    "headers", [{"Upgrade": "h2c"}, {"Upgrade": None}, {"Sec_WebSocket_Version": "8"}, {"Sec_WebSocket_Version": None},
                {"Sec_WebSocket_Key": "x"}, {"Sec_WebSocket_Key": None}, {"Connection": "close"}],
)  # fmt: skip
def test_other_handshakes_are_refused(viewer, headers):
    assert status(viewer, **headers) == 400
    still_answers(viewer)


def test_no_path_becomes_a_file(viewer):
    token = f"?token={viewer.token}"
    for path in (
        "/etc/passwd",
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/page.js",
        "/socket/",
    ):
        assert status(viewer, path + token) == 404, path


def test_a_frame_is_what_the_renderer_draws(viewer, static):
    from gavatar_runtime.player_face import Avatar
    from gavatar_runtime.view.viewed_avatar import Wish

    avatar = Avatar(read_bundle(static))
    wish, motion = Wish.of(WISH), viewer.scene.motion("turn")
    pose, trans, _ = motion.at_time(0.5)
    drawn = Renderer(avatar).draw(pose, wish.camera, trans=trans, background=wish.background)
    with Client(viewer) as page:
        head, data = page.ask_frame(**WISH, exact=True)
    assert (head["kind"], head["width"], head["height"], head["gaussians"]) == ("rgb", 64, 48, len(avatar))
    assert set(head["stages"]) >= {"decode", "skin", "blend", "all"}
    assert min(head["stages"].values()) >= 0
    got = np.frombuffer(data, np.uint8).reshape(48, 64, 3)
    wanted = np.rint(np.clip(drawn.color, 0, 1) * 255)
    # where two ways of rounding meet a half, both are right
    assert np.abs(got - wanted).max() <= 1
    assert (got != wanted).mean() < 1e-3
    assert np.ptp(got) > 100


@needs_kernel
def test_jpeg_frames_are_close(viewer):
    cv2 = pytest.importorskip("cv2", reason="reads the JPEG")
    with Client(viewer) as page:
        head, data = page.ask_frame(**WISH)
        _, exact = page.ask_frame(**WISH, exact=True)
    assert head["kind"] == "jpeg"
    got = cv2.imdecode(np.frombuffer(data, np.uint8), 1)[:, :, ::-1].astype(float)
    error = np.square(got - np.frombuffer(exact, np.uint8).reshape(48, 64, 3)).mean()
    assert 10 * np.log10(255**2 / error) > 30  # quality 90 loses 35 to 40 dB of noise-like points


@needs_kernel
@pytest.mark.usefixtures("no_opencv")
def test_frames_without_opencv_are_jpeg_too(viewer):
    with Client(viewer) as page:
        head, data = page.ask_frame(**WISH)
    assert head["kind"] == "jpeg"
    assert bytes(data[:3]) == b"\xff\xd8\xff"


def test_frames_without_the_kernel_are_as_they_are(viewer, monkeypatch):
    monkeypatch.setattr(native_library, "available", lambda: (False, "it was not compiled"))
    with Client(viewer) as page:
        head, data = page.ask_frame(**WISH)
    assert head["kind"] == "rgb"
    assert len(data) == 3 * 64 * 48


def test_wrong_wishes_are_told_and_the_connection_stays(viewer):
    wrong = {
        "motion": "waltz", "tier": "gold", "width": 0, "height": 100000, "time": "now", "gaussians": 0,
        "background": [1, 2], "camera": {**CAMERA, "view": [0] * 12},
    }  # fmt: skip
    with Client(viewer) as page:
        for name, value in wrong.items():
            error = page.ask(do="draw", **{**WISH, name: value})["error"]
            assert name in error or str(value) in error
        assert "waltz" in page.ask(do="motion", name="waltz")["error"]
        assert page.ask(do="motion", name=7)["error"]
        assert page.ask_frame(**WISH)


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (frame(1, b"not json"), 1008),
        (frame(1, b"[]"), 1008),
        (frame(1, b'{"do": "hello"}'), 1008),
        (frame(1, b'{"id": 1, "do": "quit"}'), 1008),
        (frame(1, b'{"id": 1}'), 1008),
        (frame(1, b"[" * 60000), 1008),
        (frame(2, b""), 1008),
        (frame(2, b"\xff\xff\xff\xff"), 1008),
        (frame(2, b"\x02\x00\x00\x00\xff\xff"), 1008),
        (frame(2, b"\x02\x00\x00\x00{}"), 1008),
        (frame(1, b"x", masked=False), 1002),
        (frame(1, b"x" * (1 << 16) + b"x"), 1009),
        (frame(1, b"\xff"), 1007),
    ],
)  # fmt: skip
def test_what_no_page_sends_ends_that_connection_alone(viewer, sent, code):
    with Client(viewer) as page, Client(viewer) as other:
        page.send(sent)
        assert page.closed_with() == code
        assert other.ask(do="hello")["gaussians"] == 300
    still_answers(viewer)


def test_random_frames_end_nothing_but_their_connections(viewer, capsys):
    rng = np.random.default_rng(20)
    good = [frame(1, json.dumps({"id": 1, "do": "draw", **WISH}).encode()), frame(2, b"\x10\x00\x00\x00" + bytes(40)),
            frame(9, b"hi"), frame(1, b'{"id": 2, "do": "hello"}')]  # fmt: skip
    for _ in range(100):
        data = bytearray(b"".join(good[k] for k in rng.integers(0, len(good), rng.integers(1, 4))))
        kind = rng.integers(3)
        if kind == 0:
            data = bytearray(rng.bytes(int(rng.integers(1, 200))))
        elif kind == 1:
            for k in rng.integers(0, len(data), rng.integers(1, 6)):
                data[k] = rng.integers(256)
        else:
            data = data[: rng.integers(1, len(data))]
        with Client(viewer) as page:
            page.send(bytes(data))
            page.socket.shutdown(socket.SHUT_WR)
            page.closed_with()  # reads until the server hangs up, else the socket's own 20 s end the test
    still_answers(viewer)
    assert "Traceback" not in capsys.readouterr().err


def test_random_messages_are_answered_or_end_their_connection(viewer, capsys):
    rng = np.random.default_rng(21)
    odd = [
        None,
        True,
        -1,
        0,
        1e308,
        -1e-300,
        "",
        "x" * 600,
        [],
        [1e400],
        {},
        [[1]],
        {"view": VIEW},
        2**70,
        "\ud800",
        float("nan"),
    ]
    for _ in range(120):
        message = {"id": 1, "do": "draw", **WISH, "camera": dict(CAMERA)}
        for name in rng.choice([*WISH, "id", "do", "exact"], rng.integers(1, 3)):
            message[str(name)] = odd[rng.integers(len(odd))]
        if isinstance(message["camera"], dict) and message["camera"] and rng.random() < 0.5:
            message["camera"][str(rng.choice(list(CAMERA)))] = odd[rng.integers(len(odd))]
        with Client(viewer) as page:
            page.send(frame(1, json.dumps(message).encode()))
            assert page.receive()[0] in (1, 2, 8), message
    still_answers(viewer)
    assert "Traceback" not in capsys.readouterr().err


def test_more_pages_than_it_takes_are_told(static):
    with Viewer(ViewedAvatar(read_bundle(static))) as viewer:
        pages = [Client(viewer) for _ in range(CONNECTIONS)]
        assert status(viewer) == 503
        pages.pop().socket.close()
        for _ in range(100):
            if (got := status(viewer)) == 101:
                break
            threading.Event().wait(0.05)
        assert got == 101
        for page in pages:
            page.socket.close()


def test_an_end_hangs_up(static):
    with Viewer(ViewedAvatar(read_bundle(static))) as viewer:
        page = Client(viewer)
        page.ask(do="hello")
    assert page.receive() == (-1, b"")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", viewer.port), timeout=5)


def test_an_address_that_cannot_be_had_is_one_sentence(static):
    scene = ViewedAvatar(read_bundle(static))
    with Viewer(scene) as viewer, pytest.raises(UserError, match=f"cannot listen on 127.0.0.1:{viewer.port}"):
        Viewer(scene, port=viewer.port)
    for host, port in (("256.1.1.1", 0), ("127.0.0.1", 70000)):
        with pytest.raises(UserError, match="cannot listen"):
            Viewer(scene, host, port)


def test_open_to_others_only_the_token_counts(static):
    with Viewer(ViewedAvatar(read_bundle(static)), "0.0.0.0") as viewer:
        assert status(viewer, f"/?token={viewer.token}", Host=f"somewhere.example:{viewer.port}") == 200
        assert status(viewer, "/", Host=f"somewhere.example:{viewer.port}") == 403
        assert socket.gethostname() in viewer.address


def test_in_a_notebook_it_is_a_frame(viewer):
    assert f'<iframe src="{viewer.address}"' in viewer._repr_html_()
