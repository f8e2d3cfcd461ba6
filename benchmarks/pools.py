"""Whether the kernel's threads get along with ONNX Runtime's and torch's.

Playing: an exported avatar's frames at 512x512, decoded and drawn alone, one after the other, and as `gavatar-play`
does it, decoding a frame while the one before is drawn. Training: a convolution's step in torch, the kernel's forward
and backward, and one after the other as a training step does it; with workers of OpenMP that spin when they have
nothing to do (torch's default) and that sleep (what `import gavatar` sets).

    python benchmarks/pools.py AVATAR.gavatar [--frames 60]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))


def median_ms(run, times: int) -> float:
    found = []
    for i in range(times + 3):
        start = time.perf_counter()
        run(i)
        found.append(1e3 * (time.perf_counter() - start))
    return float(np.median(found[3:]))


def playing(path: str, frames: int) -> None:
    from gavatar_runtime.avatar.playing import Avatar
    from gavatar_runtime.bundle import read_bundle
    from gavatar_runtime.decoding import network
    from gavatar_runtime.motions import read_motion
    from gavatar_runtime.play.framing import frame_motion
    from gavatar_runtime.play.outputs.nowhere import Nowhere
    from gavatar_runtime.play.player import play_images
    from gavatar_runtime.play.staging import Clip
    from gavatar_runtime.render.choice import build_rasterizer
    from gavatar_runtime.render.renderer import Renderer

    bundle, quiet = read_bundle(path), network._session
    print("threads of ORT, kernel; spin: ms decode alone, draw alone, one after the other, together")
    for spins in (False, True):
        network._session = _spinning if spins else quiet
        for decoding, drawing in ((1, 1), (1, 2), (2, 1), (2, 2)):
            avatar = Avatar(bundle, threads=decoding)
            motion, _ = avatar.fit(Clip(30.0, (frames + 3) / 30).of(read_motion("wave")))
            camera = frame_motion(avatar, motion, 512, 512)
            rasterizer = build_rasterizer("native", threads=drawing)
            gaussians = avatar.gaussians(*motion.at(0))
            decode = median_ms(lambda i: avatar.gaussians(*motion.at(i % len(motion))), frames)  # noqa: B023
            draw = median_ms(lambda i: rasterizer.render_uint8(gaussians, camera), frames)  # noqa: B023
            walls = []
            for pipelined in (False, True):
                done = play_images(Renderer(avatar, rasterizer), motion, camera, Nowhere(), pipelined=pipelined)
                walls.append(1e3 * float(np.median(done.walls[3:])))
            row = " ".join(f"{ms:.2f}" for ms in (decode, draw, *walls))
            print(f"  {decoding}, {drawing}; {spins!s:5}: {row}", flush=True)


def _spinning(bundle, member: str, threads: int | None):
    """`network._session` as ONNX Runtime would have it."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.inter_op_num_threads = 1
    if threads is not None:
        options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(bundle.read(member), options, providers=["CPUExecutionProvider"])


def training(times: int) -> None:
    """In a process of its own: OpenMP reads its policy once."""
    import torch
    from splat_scenes import as_torch, body_camera, body_scene, map_fields

    from gavatar.registry import RASTERIZERS, load_plugins

    load_plugins()
    scene = map_fields(as_torch(body_scene(50_000)), lambda x: x.requires_grad_())
    wanted, camera = (scene.means, scene.scales, scene.colors), body_camera(512, 512)
    convolution, image = torch.nn.Conv2d(32, 32, 3, padding=1), torch.randn(1, 32, 128, 128)
    upstream = torch.randn(512, 512, 3)
    for of_torch, of_kernel in ((1, 1), (1, 2), (2, 1), (2, 2)):
        torch.set_num_threads(of_torch)
        rasterizer = RASTERIZERS.build("native", {"threads": of_kernel})

        def net(_):
            convolution(image).square().mean().backward()

        def splat(_):
            torch.autograd.grad(rasterizer(scene, camera).color, wanted, upstream)  # noqa: B023

        def both(i):
            net(i)
            splat(i)

        median_ms(both, 10)  # torch makes its kernels at first use
        row = [median_ms(run, times) for run in (net, splat, both)]
        policy = os.environ["OMP_WAIT_POLICY"].lower()
        print(f"  {of_torch}, {of_kernel}; {policy:7}: " + " ".join(f"{ms:.2f}" for ms in row), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar", nargs="?")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--training", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.training:
        training(arguments.frames)
        return
    if arguments.avatar:
        playing(arguments.avatar, arguments.frames)
    print("threads of torch, kernel; workers: ms net alone, splatting alone, one after the other", flush=True)
    command = [sys.executable, __file__, "--training", "--frames", str(arguments.frames)]
    for policy in ("PASSIVE", "ACTIVE"):
        subprocess.run(command, env={**os.environ, "OMP_WAIT_POLICY": policy}, check=True)


if __name__ == "__main__":
    main()
