"""The viewer in a real browser, used by hand: mouse, keys, touch, files."""

from __future__ import annotations

import base64
import json
import time

import numpy as np
import pytest
from browser import Page, find_browser, opened_page

from gavatar_runtime.bundle import read_bundle
from gavatar_runtime.view.server import Viewer
from gavatar_runtime.view.viewed_avatar import ViewedAvatar

pytest.importorskip("onnx", reason="the hand-made networks need onnx")
from tiered_members import write_tiered

pytestmark = pytest.mark.skipif(find_browser() is None, reason="no Chromium here")
cv2 = pytest.importorskip("cv2", reason="reads the browser's pictures")


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    bundle = read_bundle(write_tiered(tmp_path_factory.mktemp("viewer") / "t.gavatar"))
    with Viewer(ViewedAvatar(bundle)) as made:
        yield made


@pytest.fixture(scope="module")
def browser():
    with opened_page() as page:
        yield page


@pytest.fixture
def page(viewer, browser):
    """The viewer's page, freshly opened and playing."""
    browser.size(900, 600)
    browser.errors.clear()
    browser.open(viewer.address)
    browser.wait("window.controls && controls.state.motion && controls.engine.frames > 2")
    yield browser
    assert not browser.errors


def state(page: Page, name: str):
    return page.evaluate(f"controls.state.{name}")


def click(page: Page, part: str) -> None:
    x, y = page.evaluate(
        f"(() => {{ const r = document.querySelector('[data-part={part}]').getBoundingClientRect();"
        "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.input("dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


def press(page: Page, key: str, code: int) -> None:
    for kind in ("keyDown", "keyUp"):
        page.input("dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code)


def drag(page: Page, dx: float, dy: float, button: str = "left") -> None:
    held = {"left": 1, "right": 2}[button]
    x, y = 300.0, 250.0
    page.input("dispatchMouseEvent", type="mousePressed", x=x, y=y, button=button, buttons=held, clickCount=1)
    for k in range(1, 5):
        page.input(
            "dispatchMouseEvent", type="mouseMoved", x=x + dx * k / 4, y=y + dy * k / 4, button=button, buttons=held
        )
    page.input("dispatchMouseEvent", type="mouseReleased", x=x + dx, y=y + dy, button=button, buttons=0, clickCount=1)


def test_frames_reach_the_page_and_show_the_person(page, tmp_path):
    page.wait("controls.engine.frames > 10")
    shown = page.evaluate("[controls.engine.canvas.width, controls.engine.canvas.height, controls.size()]")
    assert shown[:2] == [shown[2]["width"], shown[2]["height"]]
    picture = cv2.imread(str(page.screenshot(tmp_path / "view.png")))
    assert (picture[:480, :600] < 240).any(2).mean() > 0.001
    page.wait("/[1-9]\\d* fps .*60 Gaussians .*decode/.test(document.querySelector('[data-part=stats]').textContent)")


def test_play_pause_step_and_scrub(page):
    click(page, "play")
    assert state(page, "playing") is False
    drawn = page.wait("controls.engine.asked === 0 && controls.engine.frames")
    page.evaluate("new Promise((r) => setTimeout(r, 400))")
    assert page.evaluate("controls.engine.frames") <= drawn + 1  # a page that stands still asks for nothing
    before = page.evaluate("controls.frame()")
    click(page, "next")
    assert page.evaluate("controls.frame()") == before + 1
    press(page, "ArrowLeft", 37)
    press(page, "ArrowLeft", 37)
    assert page.evaluate("controls.frame()") == before - 1 or before == 0
    click(page, "scrub")  # its middle
    count = page.evaluate("controls.state.motion.count")
    assert abs(page.evaluate("controls.frame()") - count / 2) < 0.05 * count
    press(page, " ", 32)
    assert state(page, "playing") is True
    page.wait(f"controls.engine.frames > {drawn} + 6")


def test_orbit_pan_zoom_and_reset_by_mouse(page):
    start = state(page, "camera")
    drag(page, 100, 40)
    turned = state(page, "camera")
    assert turned["azimuth"] < start["azimuth"] - 0.5
    assert turned["elevation"] > start["elevation"] + 0.2
    drag(page, 60, 0, "right")
    assert np.linalg.norm(np.subtract(state(page, "camera")["target"], start["target"])) > 0.05
    page.input("dispatchMouseEvent", type="mouseWheel", x=300, y=250, deltaX=0, deltaY=-300)
    page.wait(f"controls.state.camera.distance < 0.9 * {start['distance']}")
    click(page, "reset")
    again = state(page, "camera")
    assert again.pop("target") == pytest.approx(start.pop("target"))
    assert again == pytest.approx(start)


def test_orbit_and_pinch_by_touch(page):
    start = state(page, "camera")

    def touch(kind: str, *points: tuple[float, float]) -> None:
        page.input(
            "dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        )

    touch("touchStart", (300, 250))
    for k in range(1, 6):
        touch("touchMove", (300 + 20 * k, 250))
    touch("touchEnd")
    assert state(page, "camera")["azimuth"] < start["azimuth"] - 0.4
    touch("touchStart", (280, 250), (320, 250))
    for k in range(1, 6):
        touch("touchMove", (280 - 10 * k, 250), (320 + 10 * k, 250))
    touch("touchEnd")
    assert state(page, "camera")["distance"] < 0.6 * start["distance"]  # fingers 3.5 times as far apart


def test_tier_gaussians_and_background(page):
    def choose(part: str, value: str) -> None:
        page.evaluate(
            f"(() => {{ const e = document.querySelector('[data-part={part}]'); e.value = '{value}';"
            "e.dispatchEvent(new Event(e.type === 'range' ? 'input' : 'change')); })()"
        )

    click(page, "play")
    choose("background", "green")
    choose("tier", "blendshape")
    page.wait("!controls.dirty && controls.engine.asked === 0 && controls.engine.stages.decode !== undefined")
    corner = page.evaluate("[...controls.engine.context.getImageData(2, 2, 1, 1).data]")
    assert np.abs(np.subtract(corner[:3], [0, 255, 0])).max() < 4
    assert page.evaluate("controls.view().tier") == "blendshape"


def give(page: Page, name: str, data: bytes, how: str) -> None:
    """A file, dropped on the page or chosen."""
    text = base64.b64encode(data).decode()
    page.evaluate(
        f"(() => {{ const bytes = Uint8Array.from(atob('{text}'), (c) => c.charCodeAt(0)), all = new DataTransfer();"
        f"all.items.add(new File([bytes], {json.dumps(name)}));"
        f"if ('drop' === '{how}') document.dispatchEvent(new DragEvent('drop', "
        "{ dataTransfer: all, bubbles: true, cancelable: true }));"
        "else { const e = document.querySelector('[data-part=file]'); e.files = all.files;"
        "e.dispatchEvent(new Event('change')); } })()"
    )  # fmt: skip


@pytest.mark.parametrize("how", ["drop", "choose"])
def test_a_motion_file_plays(page, tmp_path, how):
    np.savez(tmp_path / "m.npz", poses=np.zeros((7, 156)), trans=np.zeros((7, 3)), mocap_framerate=30.0)
    give(page, f"walk {how}.npz", (tmp_path / "m.npz").read_bytes(), how)
    page.wait(f"controls.state.motion.name === 'walk {how}'")
    assert state(page, "motion.count") == 7
    assert page.evaluate("document.querySelector('[data-part=motion]').value") == f"walk {how}"


def test_a_motion_elsewhere_is_in_the_picture(page, tmp_path):
    """As that of a .bvh, whose pelvis is a metre above the floor: also where the view was turned before."""
    np.savez(tmp_path / "m.npz", poses=np.zeros((7, 156)), trans=np.tile([5.0, 1.0, 0], (7, 1)), mocap_framerate=30.0)
    center = page.evaluate("controls.state.motion.extent.center")
    give(page, "far.npz", (tmp_path / "m.npz").read_bytes(), "choose")
    page.wait("controls.state.motion.name === 'far'")
    assert page.evaluate("controls.state.camera.target") == page.evaluate("controls.state.motion.extent.center")
    drag(page, 60, 0)
    turned = page.evaluate("controls.state.camera.azimuth")
    page.evaluate("controls.play('idle')")
    page.wait("controls.state.motion.name === 'idle'")
    assert np.allclose(page.evaluate("controls.state.camera.target"), center, atol=1e-6)
    assert page.evaluate("controls.state.camera.azimuth") == turned  # the view that the user chose


def test_a_file_that_is_none_is_told_and_the_motion_goes_on(page):
    give(page, "nothing.npz", b"no archive", "drop")
    page.wait("document.querySelector('[data-part=notes] .wrong')?.textContent.includes('nothing.npz')")
    drawn = page.evaluate("controls.engine.frames")
    page.wait(f"controls.engine.frames > {drawn} + 3")


def test_a_screenshot_has_no_losses(page, viewer):
    from gavatar_runtime.view.viewed_avatar import Wish

    click(page, "play")
    url = page.evaluate(
        "(async () => { const b = await controls.engine.picture(controls.view()); return new Promise((r) => {"
        "const f = new FileReader(); f.onload = () => r(f.result); f.readAsDataURL(b); }); })()"
    )
    got = cv2.imdecode(np.frombuffer(base64.b64decode(url.split(",")[1]), np.uint8), 1)[:, :, ::-1]
    wish = page.evaluate("controls.view()")
    assert np.array_equal(got, viewer.scene.draw(Wish.of(wish))[0])


def test_a_recording_is_a_video_that_shows_the_person_move(page, tmp_path):
    page.command("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    page.evaluate("controls.play('dance')")
    click(page, "record")
    page.wait("controls.recorder?.state === 'recording'")
    before = page.evaluate("controls.engine.frames")
    page.wait(f"controls.engine.frames > {before} + 15")
    click(page, "record")
    page.wait("!controls.recorder")
    end = time.monotonic() + 20
    while not (found := [p for p in tmp_path.iterdir() if p.suffix in (".mp4", ".webm") and p.stat().st_size]):
        assert time.monotonic() < end
        time.sleep(0.1)
    video, frames = cv2.VideoCapture(str(found[0])), []
    while (read := video.read())[0]:
        frames.append(read[1].astype(float))
    assert len(frames) > 5
    assert max(np.ptp(frame) for frame in frames) > 100  # the person on the background
    assert np.abs(frames[-1] - frames[1]).max() > 50  # who moved


def test_the_command_that_makes_the_view(page):
    click(page, "play")
    command = page.evaluate("controls.engine.command(controls.view())")
    assert command.startswith("gavatar-play ")
    assert "--motion" in command
    assert "--frames" in command


def test_a_narrow_screen_shows_the_person_and_hides_the_panel(page, viewer, tmp_path):
    page.size(390, 760, mobile=True)
    page.open(viewer.address)
    page.wait("window.controls && controls.state.motion && controls.engine.frames > 2")
    assert page.evaluate("document.querySelector('[data-part=panel]').open") is False
    panel, canvas, wide = page.evaluate(
        "[document.querySelector('aside').getBoundingClientRect().height,"
        "document.querySelector('canvas').getBoundingClientRect().height, document.documentElement.scrollWidth]"
    )
    assert panel < 50
    assert canvas > 550
    assert wide == 390
    click(page, "name")
    assert page.evaluate("document.querySelector('[data-part=panel]').open") is True


def test_an_end_of_the_server_is_told(browser, tmp_path):
    bundle = read_bundle(write_tiered(tmp_path / "t.gavatar"))
    with Viewer(ViewedAvatar(bundle)) as viewer:
        browser.open(viewer.address)
        browser.wait("window.controls && controls.engine.frames > 2")
    browser.wait("document.querySelector('[data-part=notes]').textContent.includes('has ended')", 20)
