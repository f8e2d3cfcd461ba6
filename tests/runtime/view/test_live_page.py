"""Live driving in a real browser: a clip on the server, and the page's own camera, which a file stands in for."""

from __future__ import annotations

import numpy as np
import pytest
from browser import find_browser, opened_page
from live_people import Told, raised

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.view.drive import Drive
from gavatar_runtime.view.server import Viewer
from gavatar_runtime.view.viewed_avatar import ViewedAvatar

pytestmark = pytest.mark.skipif(find_browser() is None, reason="no Chromium here")
cv2 = pytest.importorskip("cv2", reason="writes the camera's pictures")
FAKE = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
SHOWN = "window.drive && drive.live && drive.live.state"


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A red camera, as Chromium's fake one reads it."""
    path = tmp_path_factory.mktemp("camera") / "red.mjpeg"
    image = np.zeros((240, 320, 3), np.uint8)
    image[..., 2] = 220
    path.write_bytes(cv2.imencode(".jpg", image)[1].tobytes() * 30)
    return path


def test_the_pages_camera_drives(static, film):
    told = Told(lambda k: raised(0.01 * k))
    scene = ViewedAvatar(read_bundle(static))
    scene.drive = Drive(scene.body, driver=told)
    with Viewer(scene) as viewer, opened_page(*FAKE, f"--use-file-for-fake-video-capture={film}") as page:
        page.open(viewer.address)
        page.wait("window.drive && controls.state.motion")
        assert page.evaluate("document.querySelector('figure').hidden")
        assert page.evaluate("getComputedStyle(document.querySelector('figure')).display") == "none"
        page.evaluate("document.querySelector('[data-part=camera]').click()")
        page.wait(f"{SHOWN} === 'following' && drive.live.number > 3")
        assert page.evaluate("controls.state.motion.name") == "(live)"
        red, green, _, _ = page.wait(
            "(() => { const c = drive.inset; if (c.width !== 320) return null;"
            "return [...c.getContext('2d').getImageData(200, 200, 1, 1).data]; })()"
        )
        assert red > 150, "the camera's own picture stands beside the avatar"
        assert green < 60
        assert 0 < page.evaluate("drive.delay") < 10
        page.evaluate("document.querySelector('[data-part=camera]').click()")
        assert page.evaluate("document.querySelector('[data-part=camera]').textContent") == "Use my camera"
        assert not page.errors
    assert scene.drive.following.newest().picture.shape == (240, 320, 3)
    scene.drive.close()


def test_a_camera_that_is_refused_is_a_sentence(static):
    scene = ViewedAvatar(read_bundle(static))
    scene.drive = Drive(scene.body, driver=Told())
    with Viewer(scene) as viewer, opened_page() as page:
        page.open(viewer.address)
        page.wait("window.drive && controls.state.motion")
        page.evaluate(
            "navigator.mediaDevices.getUserMedia = async () => { throw new DOMException('', 'NotAllowedError'); }"
        )
        page.evaluate("document.querySelector('[data-part=camera]').click()")
        page.wait("document.querySelector('[data-part=notes] .wrong') !== null")
        assert page.evaluate("drive.camera === null && controls.state.motion.name") == scene.motion_names[0]
    scene.drive.close()


class Clip:
    name, camera = "clip.mp4", None

    def __init__(self):
        self.k = 0

    def read(self):
        self.k += 1
        return np.full((120, 160, 3), (0, 200, 0), np.uint8), self.k / 30

    def close(self): ...


def test_a_clip_of_the_server(static):
    scene = ViewedAvatar(read_bundle(static))
    scene.drive = Drive(scene.body, Clip(), Told())
    with Viewer(scene) as viewer, opened_page() as page:
        page.open(viewer.address)
        page.wait(f"{SHOWN} === 'following' && drive.inset.width === 160")
        assert page.evaluate("document.querySelector('[data-part=camera]') === null"), "the clip drives"
        before = page.evaluate("controls.engine.frames")
        page.wait(f"controls.engine.frames > {before} + 3")
        page.evaluate("controls.play('turn')")
        page.wait("document.querySelector('figure').hidden")
        assert not page.errors
    scene.drive.close()
