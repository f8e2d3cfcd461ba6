"""The viewer driven by a camera: what it tells a page, what it takes from one."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from live_people import Told, raised

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.errors import UserError, WrongValue
from gavatar_runtime.live import drivers
from gavatar_runtime.view import drive as module
from gavatar_runtime.view.drive import LIVE, Drive
from gavatar_runtime.view.server import serve
from gavatar_runtime.view.viewed_avatar import ViewedAvatar
from gavatar_runtime.view.websocket import Closed

cv2 = pytest.importorskip("cv2", reason="writes the pictures")
CAMERA = {"view": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 3], "fx": 80, "fy": 80, "cx": 32, "cy": 24}
WISH = {"do": "draw", "motion": LIVE, "time": 0.0, "camera": CAMERA, "background": [1, 1, 1], "width": 64, "height": 48,
        "tier": "full", "gaussians": None}  # fmt: skip
JPEG = cv2.imencode(".jpg", np.full((480, 640, 3), 128, np.uint8))[1].tobytes()


class Page:
    """A connection that says what it is told to and keeps the answers."""

    def __init__(self, *messages):
        self.messages, self.answers, self.closed = list(messages), [], None

    def receive(self):
        if not self.messages:
            raise Closed(1000)
        return self.messages.pop(0)

    def send_text(self, text):
        self.answers.append(json.loads(text))

    def send_bytes(self, *parts):
        data = b"".join(bytes(part) for part in parts)
        length = struct.unpack("<I", data[:4])[0]
        self.answers.append((json.loads(data[4 : 4 + length]), data[4 + length :]))

    def close(self, code=1000, reason=""):
        self.closed = code, reason


def said(**message) -> str:
    return json.dumps({"id": 1, **message})


def sent(data: bytes, number=7) -> bytes:
    head = json.dumps({"id": number, "do": "camera"}).encode()
    return struct.pack("<I", len(head)) + head + data


class Clip:
    name, camera, rate = "clip.mp4", None, 30.0

    def __init__(self):
        self.k = 0

    def read(self):
        self.k += 1
        return np.full((480, 640, 3), 30, np.uint8), self.k / 30

    def close(self): ...


@pytest.fixture
def scene(static):
    made = ViewedAvatar(read_bundle(static))
    yield made
    if made.drive is not None:
        made.drive.close()


def talk(scene, *messages) -> list:
    page = Page(*messages)
    serve(page, scene)
    assert page.closed is None
    return page.answers


def test_a_viewer_without_it_tells_nothing_of_it(scene):
    hello, refused = talk(scene, said(do="hello"), sent(JPEG))
    assert hello["drive"] is None
    assert LIVE not in hello["motions"]
    assert refused == {"id": 7, "error": "this viewer cannot be driven by a camera"}


def test_a_clip_drives(scene):
    scene.drive = Drive(scene.body, Clip(), Told(lambda k: raised(0.5)))
    hello, motion, (head, data), refused = talk(
        scene, said(do="hello"), said(do="motion", name=LIVE), said(**WISH), sent(JPEG)
    )
    assert hello["drive"] == {"motion": LIVE, "source": "clip.mp4", "camera": False}
    assert hello["motions"][0] == LIVE
    assert motion["count"] == 1
    assert motion["extent"]["high"][1] > motion["extent"]["low"][1]
    live = head["live"]
    assert live["state"] == "following"
    assert live["points"][0] == pytest.approx([1 / 640, 2 / 480, 1.0], abs=1e-4)
    picture = cv2.imdecode(np.frombuffer(data[len(data) - live["bytes"] :], np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (240, 320, 3)
    assert abs(picture.mean() - 30) < 3
    avatar = cv2.imdecode(np.frombuffer(data[: len(data) - live["bytes"]], np.uint8), cv2.IMREAD_COLOR)
    assert avatar.shape == (48, 64, 3)
    assert head["stages"]["follow"] >= 0
    assert "clip.mp4 drives this avatar" in refused["error"]


def test_the_drawn_pose_is_the_persons(scene):
    scene.drive = Drive(scene.body, driver=Told(lambda k: raised(1.2)))
    page = Page()
    scene.drive.take(page, JPEG)
    shown = scene.drive.next(page)
    assert shown.pose[16] == pytest.approx([0, 0, 1.2])


def test_a_pages_camera_drives(scene):
    scene.drive = Drive(scene.body, driver=Told())
    assert scene.drive.told() == {"motion": LIVE, "source": None, "camera": True}
    hello, (waiting, _), taken, (head, data) = talk(scene, said(do="hello"), said(**WISH), sent(JPEG), said(**WISH))
    assert LIVE not in hello["motions"]
    assert waiting["live"]["state"] == "waiting"
    assert taken == {"id": 7}
    assert head["live"]["tag"] == 7
    assert head["live"]["bytes"] == 0
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape == (48, 64, 3)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", JPEG[:200], b"x" * 100, bytes(3 << 20)])
def test_a_malformed_picture_is_a_sentence(scene, data):
    scene.drive = Drive(scene.body, driver=Told())
    refused, after = talk(scene, sent(data), sent(JPEG))
    assert refused["error"].startswith("the camera's picture")
    assert after == {"id": 7}


def test_one_pages_camera_at_a_time(scene, monkeypatch):
    scene.drive = Drive(scene.body, driver=Told())
    mine, other = Page(), Page()
    scene.drive.take(mine, JPEG)
    with pytest.raises(WrongValue, match="another page"):
        scene.drive.take(other, JPEG)
    monkeypatch.setattr(module, "OWNED", 0.0)
    scene.drive.take(other, JPEG)


def test_a_page_is_not_sent_the_same_twice_unless_nothing_comes(scene, monkeypatch):
    monkeypatch.setattr(module, "WAIT", 0.05)
    scene.drive = Drive(scene.body, driver=Told())
    page = Page()
    scene.drive.take(page, JPEG)
    assert [scene.drive.next(page).number for _ in range(3)] == [1, 1, 1]
    scene.drive.take(page, JPEG)
    assert scene.drive.next(page).number == 2


def test_without_a_driver_the_button_is_not_offered(scene, monkeypatch):
    monkeypatch.setattr(module, "why_not", lambda: "install it")
    monkeypatch.setattr(drivers, "why_not", lambda: "install it")
    scene.drive = Drive(scene.body)
    assert scene.drive.told()["camera"] is False
    (refused,) = talk(scene, sent(JPEG))
    assert refused["error"] == "install it"
    with pytest.raises(UserError, match="install it"):
        Drive(scene.body, Clip())
