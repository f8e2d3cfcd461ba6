"""The viewer and the web page in headless Chromium: frames a second, milliseconds of each part, file sizes, PSNR.

    python benchmarks/web.py NAME.gavatar OTHER.gavatar

The browser runs on the same machine and has no GPU: frames of the viewer are drawn by our kernel, which it shares the
cores with; the web page's own thread is timed without the drawing, which a visitor's GPU does.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from browser import Page, opened_page

from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.bundle import Bundle, read_bundle
from gavatar_runtime.conversions import convert
from gavatar_runtime.formats.files import atomic
from gavatar_runtime.motions import read_motion
from gavatar_runtime.play.framing import frame_motion, orbit
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.view.frame_encoding import encoded
from gavatar_runtime.view.server import Viewer
from gavatar_runtime.view.viewed_avatar import ViewedAvatar
from gavatar_runtime.web.look import read_look

FRAMES = 8  # of the page, timed one by one: without a GPU the drawing between them takes seconds
COUNTS = (10_000, 50_000, 100_000, 200_000)
FRAMED = """(async () => {
  const rows = [], gl = a.gl, m = await a.setMotion("wave");
  for (let k = 0; k < %d; k++) {
    a.setTime(k / m.fps);
    const pose = a.milliseconds.pose;
    await a.renderSorted(%s);
    rows.push([pose, a.milliseconds.draw, a.milliseconds.sort]);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for what is drawn, untimed
  }
  const middle = (k) => rows.map((r) => r[k]).sort((x, y) => x - y)[rows.length >> 1];
  return [middle(0), middle(1), middle(2)];
})()"""


def viewer_rows(bundle: Bundle, sizes: list[int], seconds: float) -> None:
    """Frames that reach the page, by tier and size."""
    print("\n| tier | pixels | fps in the page | drawn in ms | of it decode | JPEG ms |\n|---|---|---|---|---|---|")
    with Viewer(ViewedAvatar(bundle)) as viewer, opened_page() as page:
        for tier in viewer.scene.tiers:
            for size in sizes:
                page.size(size, size + 200)
                page.open(viewer.address)
                page.wait("window.controls && controls.engine.frames > 0")
                footer = page.evaluate("document.querySelector('footer').offsetHeight")
                page.size(size, size + footer)
                page.evaluate(f"controls.state.tier = {json.dumps(tier)}")
                start = page.wait(f"controls.engine.canvas.height === {size} && controls.engine.frames") + 5
                page.wait(f"controls.engine.frames > {start}", 120)  # the tier is open
                shown, ms, rows = page.evaluate(
                    "(async () => { const e = controls.engine, f = e.frames, t = performance.now(), rows = [];"
                    f"while (performance.now() - t < {1000 * seconds}) {{"
                    "await new Promise((r) => setTimeout(r, 50)); rows.push(e.stages); }"
                    "return [e.frames - f, performance.now() - t, rows]; })()"
                )
                drawn, decode, picture = (
                    float(np.median([row.get(name, 0) for row in rows])) for name in ("all", "decode", "picture")
                )
                print(f"| {tier} | {size} | {1000 * shown / ms:.0f} | {drawn:.1f} | {decode:.1f} | {picture:.1f} |")


def said(camera: Camera) -> str:
    """A camera as the page's `render` takes it."""
    view = camera.T_camera_world.ravel().tolist()
    lens = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    return json.dumps({"view": view, **lens})


def page_psnr(page: Page, avatar: Avatar, size: int) -> dict[str, float]:
    """dB of the page's pictures against the player's at the page's tier, by the camera's place."""
    motion, _ = avatar.fit(read_motion("wave"))
    front = frame_motion(avatar, motion, size, size)
    center = avatar.gaussians(motion.poses[0], motion.trans[0]).means.mean(0)
    cameras = dict(zip(("front", "side", "back"), orbit(front, center, np.array([0, 0.25, 0.5])), strict=True))
    for name, factor in (("near", 0.4), ("far", 5.0)):
        T = front.T_camera_world.copy()
        T[2, 3] = T[2, 3] * factor + (factor - 1) * (T[2, :3] @ center)
        cameras[name] = Camera(size, size, front.fx, front.fy, front.cx, front.cy, T)
    renderer, found = Renderer(avatar), {}
    for name, camera in cameras.items():
        url = page.evaluate(
            f"(async () => {{ await a.setMotion('wave'); a.setTime(10 / {motion.fps});"
            f"await a.renderSorted({said(camera)});"
            "return a.canvas.toDataURL('image/png'); })()"
        )
        got = cv2.imdecode(np.frombuffer(base64.b64decode(url.split(",")[1]), np.uint8), 1)[:, :, ::-1]
        ours = renderer.draw(motion.poses[10], camera, trans=motion.trans[10]).color
        error = np.square(np.rint(np.clip(ours, 0, 1) * 255) - got).mean()
        found[name] = float(10 * np.log10(255**2 / error))
    return found


def page_rows(bundle: Bundle, size: int) -> None:
    """The web page: its file, its pictures against the player's, its thread."""
    with tempfile.TemporaryDirectory() as folder, opened_page() as page:
        path = Path(folder, "a.html")
        convert(bundle, path, motions=("turn", "wave"))
        look = read_look(Avatar(bundle, tier=None))
        page.open(path)
        page.wait("gavatar.page && gavatar.page.then((c) => c.engine.avatar.complete).then(() => true)", 120)
        page.evaluate("gavatar.page.then((c) => { c.tick = () => {}; window.a = c.engine.avatar; })")
        avatar = Avatar(bundle, tier=look.tier)
        decibels = "  ".join(f"{name} {db:.1f}" for name, db in page_psnr(page, avatar, size).items())
        print(
            f"\npage: {len(look):,} Gaussians, tier {look.tier}, {path.stat().st_size / 1e6:.1f} MB; PSNR: {decibels}"
        )
        print("\n| Gaussians | pose ms | draw submission ms | sort ms (worker) |\n|---|---|---|---|")
        motion, _ = avatar.fit(read_motion("wave"))
        camera = said(frame_motion(avatar, motion, size, size))
        for count in sorted({min(count, len(look)) for count in COUNTS} | {len(look)}):
            page.evaluate(f"a.setLimit({count})")
            pose, draw, sort = page.evaluate(FRAMED % (FRAMES, camera), 300)
            print(f"| {count:,} | {pose:.2f} | {draw:.2f} | {sort:.1f} |")


def jpeg_row(bundle: Bundle, sizes: list[int]) -> None:
    """Milliseconds and bytes of one frame as it travels."""
    avatar = Avatar(bundle)
    motion, _ = avatar.fit(read_motion("wave"))
    for size in sizes:
        camera = frame_motion(avatar, motion, size, size)
        renderer = Renderer(avatar)
        gaussians = renderer.gaussians(motion.poses[0], motion.trans[0], camera=camera)
        kind, data = encoded(renderer.rasterize_uint8(gaussians, camera, (1, 1, 1)).copy())
        print(f"{size}x{size}: {kind} of {len(data) / 1000:.0f} kB")


def figure(bundle: Bundle, path: Path) -> None:
    """The viewer's page, and what a phone shows of the web page, side by side."""
    with tempfile.TemporaryDirectory() as folder, opened_page() as page, Viewer(ViewedAvatar(bundle)) as viewer:
        shots = []
        convert(bundle, html := Path(folder, "a.html"), motions=("wave",))
        ready = "window.controls && controls.engine.frames > 20 && controls.engine"
        drawn = "gavatar.page.then((c) => c.engine.avatar.complete).then(() => true)"
        for address, size, wait in ((viewer.address, (860, 600), ready), (html, (320, 600), drawn)):
            page.size(*size, mobile=size[0] < 400)
            page.open(address)
            page.wait(f"{wait} && new Promise((done) => setTimeout(() => done(true), 1500))")
            shots.append(cv2.imread(str(page.screenshot(Path(folder, "shot.png")))))
        picture = cv2.copyMakeBorder(np.concatenate(shots, 1), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(200, 200, 200))
        picture[:, shots[0].shape[1]] = 200
        with atomic(path) as temporary:
            temporary.write_bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("bundles", nargs="+", metavar="NAME.gavatar")
    p.add_argument("--sizes", type=int, nargs="+", default=[512, 1024], help="pixels of a side (default: 512 1024)")
    p.add_argument("--seconds", type=float, default=4.0, help="each rate is measured over (default: 4)")
    p.add_argument("--page-only", action="store_true", help="leave out the viewer")
    p.add_argument("--figure", type=Path, metavar="FILE", help="a picture of the pages with the first bundle, alone")
    arguments = p.parse_args()
    if arguments.figure:
        figure(read_bundle(arguments.bundles[0]), arguments.figure)
        return
    for path in arguments.bundles:
        bundle = read_bundle(path)
        load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
        print(
            f"\n## {bundle.manifest.name}: {bundle.manifest.gaussians:,} Gaussians; {os.cpu_count()} cores, load {load}"
        )
        jpeg_row(bundle, arguments.sizes)
        if not arguments.page_only:
            viewer_rows(bundle, arguments.sizes, arguments.seconds)
        page_rows(bundle, arguments.sizes[0])


if __name__ == "__main__":
    main()
