"""The compiled kernel among threads and processes."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from children import child_environment
from native_bench import GENERAL, built, gradients, images
from places import ROOT
from splat_scenes import as_numpy, random_scene, simple_camera

from gavatar_plugins.rasterizers.native import NativeRasterizer as Trainer
from gavatar_plugins.rasterizers.native import NativeRasterizerConfig
from gavatar_runtime import native_library as nl
from gavatar_runtime.cpus import usable_cpus
from gavatar_runtime.errors import UserError
from gavatar_runtime.render.rasterizers.native import NativeConfig
from gavatar_runtime.render.rasterizers.native import NativeRasterizer as Player

pytestmark = [built, pytest.mark.usefixtures("kernel_defaults_afterwards")]


@pytest.mark.parametrize("kind", [{}, GENERAL])
def test_the_number_of_threads_changes_no_bit(kind):
    scene, camera = as_numpy(random_scene(7, 9000, scale=0.01, **kind)), simple_camera(200, 130)
    first = None
    for count in (1, 2, 3, 7):
        result = gradients(Trainer(NativeRasterizerConfig(threads=count)), scene, camera)
        assert nl.threads() == count
        everything = [*images(result.pop("rendering")), *result.values()]
        first = first or everything
        for a, b in zip(everything[:-1], first[:-1], strict=True):  # the background's gradient is torch's sum
            np.testing.assert_array_equal(a, b)


def test_threads_default_to_the_cores_of_the_process():
    nl.set_threads(0)
    assert nl.threads() == usable_cpus()
    with pytest.raises(UserError, match=r"rasterizer\.threads"):
        Player(NativeConfig(threads=-1))


def test_concurrent_callers_get_their_own_pictures():
    scenes = [as_numpy(random_scene(seed, 500, **GENERAL)) for seed in range(4)]
    camera = simple_camera(100, 80)
    alone = [np.array(Player().render(scene, camera).color) for scene in scenes]
    wrong = []

    def draw(k: int) -> None:
        player = Player()
        for _ in range(20):
            if not np.array_equal(player.render(scenes[k], camera).color, alone[k]):
                wrong.append(k)

    threads = [threading.Thread(target=draw, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for turn in range(10):  # a pool that changes size under way
        nl.set_threads(1 + turn % 3)
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_draws_too():
    script = """
import os, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from splat_scenes import as_numpy, random_scene, simple_camera
from gavatar_runtime.render.rasterizers.native import NativeConfig, NativeRasterizer
player, camera = NativeRasterizer(NativeConfig(threads=2)), simple_camera(128, 96)
scene = as_numpy(random_scene(0, 20000, scale=0.01))
before = np.array(player.render(scene, camera).color)
child = os.fork()
same = np.array_equal(player.render(scene, camera).color, before)
if child == 0:
    os._exit(0 if same else 1)
sys.exit(0 if same and os.waitpid(child, 0)[1] == 0 else 1)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(ROOT / "tests" / "support")], timeout=60, env=child_environment()
    )
    assert done.returncode == 0


def test_denormals_are_left_alone():
    script = """
import numpy as np
from gavatar_runtime.values.camera import Camera
from gavatar_runtime.values.gaussians import Gaussians
from gavatar_runtime.render.rasterizers.native import NativeRasterizer
one = np.ones((1, 3), np.float32)
NativeRasterizer().render(Gaussians(one, one[:, 0], one), Camera(8, 8, 8.0, 8.0, 4.0, 4.0, np.eye(4)))
tiny = np.full(100, np.finfo(np.float32).tiny)
assert (tiny / 2 > 0).all() and (tiny / 2 * 2 == tiny).all()
"""
    assert subprocess.run([sys.executable, "-c", script], timeout=60, env=child_environment()).returncode == 0
