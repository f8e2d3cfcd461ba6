"""Threads stay on the CPUs that the process was given: affinity, quotas of control groups, all pools."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from children import child_environment

from gavatar_runtime import cpus
from gavatar_runtime.cpus import cpu_quota, usable_cpus

linux = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system has no affinity")

# A process that decodes and draws a frame, and tells on which CPUs each of its threads may run.
PLAY = """
import json, os, sys
from pathlib import Path
bundle, threads, cpu = sys.argv[1], int(sys.argv[2]) or None, sys.argv[3]
if cpu:
    os.sched_setaffinity(0, {int(cpu)})
import numpy as np
import onnxruntime  # its import alone starts a thread
from gavatar_runtime.avatar.playing import Avatar
from gavatar_runtime.render.choice import best_rasterizer
from gavatar_runtime.render.renderer import Renderer
from gavatar_runtime.values.camera import Camera, look_at
tasks = Path("/proc/self/task")
before = {task.name for task in tasks.iterdir()}
renderer = Renderer(Avatar(bundle, threads=threads), best_rasterizer(), threads=threads)
pose = np.zeros((len(renderer.avatar.joint_names), 3))
renderer.draw(pose, Camera(300, 300, 150, 150, 300, 300, look_at((0, 1, 3), (0, 1, 0))))
allowed = {task.name: line.split(":")[1].strip() for task in tasks.iterdir()
           for line in (task / "status").read_text().splitlines() if line.startswith("Cpus_allowed_list")}
print(json.dumps({"allowed": sorted(set(allowed.values())), "added": len(set(allowed) - before)}))
"""


def played(bundle, threads: int = 0, cpu: int | str = "") -> dict:
    command = [sys.executable, "-c", PLAY, str(bundle), str(threads), str(cpu)]
    # NumPy's products start no threads of their own, so that what is added is ours and ONNX Runtime's
    environment = child_environment(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# Affinity


@linux
def test_on_one_cpu_no_pool_starts_a_thread(dynamic):
    cpu = min(os.sched_getaffinity(0))
    assert played(dynamic, cpu=cpu) == {"allowed": [str(cpu)], "added": 0}


@linux
def test_threads_that_were_asked_for_stay_on_the_cpus_given_too(dynamic):
    cpu = min(os.sched_getaffinity(0))
    result = played(dynamic, threads=3, cpu=cpu)
    assert result["allowed"] == [str(cpu)]
    assert result["added"] >= 2


@linux
def test_no_worker_is_bound_to_a_cpu_of_its_own(dynamic):
    """ONNX Runtime binds them where it is not given a number."""
    result = played(dynamic)
    assert len(result["allowed"]) == 1
    assert result["added"] >= usable_cpus() - 1


@linux
def test_the_count_follows_the_affinity():
    script = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    script += "from gavatar_runtime.cpus import usable_cpus; print(usable_cpus())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=child_environment())
    assert done.stdout == "1\n", done.stderr


def test_without_affinity_the_machine_is_counted(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 12)
    assert usable_cpus(tmp_path) == 12
    monkeypatch.setattr(os, "cpu_count", lambda: None)  # the system does not tell
    assert usable_cpus(tmp_path) == 1


# Quotas


@pytest.fixture
def many(monkeypatch):
    """A machine of 64 CPUs, all of them allowed."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)


def system(root, groups: str, mounts: str, **files: str):
    """A folder like `/` with its control groups. files: their contents by path, `__` for `/`."""
    for name, text in {"proc/self/cgroup": groups, "proc/self/mountinfo": mounts, **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


V2 = "29 23 0:26 {root} /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n"
V1 = "32 31 0:29 {root} /sys/fs/cgroup/cpu,cpuacct rw,relatime - cgroup cgroup rw,cpu,cpuacct\n"
OTHER = "39 31 0:36 / /sys/fs/cgroup/pids rw,relatime - cgroup cgroup rw,pids\n22 1 0:5 / /proc rw - proc proc rw\n"


def v2(root, text: str, own: str = "/", mount: str = "/", at: str = ""):
    return system(root, f"0::{own}\n", V2.format(root=mount), **{f"sys/fs/cgroup/{at}cpu.max": text})


def v1(root, quota: int, period: int, own: str = "/docker/ab", mount: str = "/docker/ab", at: str = ""):
    folder = f"sys/fs/cgroup/cpu,cpuacct/{at}"
    return system(
        root, f"5:pids:/\n4:cpu,cpuacct:{own}\n1:name=systemd:/\n", OTHER + V1.format(root=mount),
        **{f"{folder}cpu.cfs_quota_us": f"{quota}\n", f"{folder}cpu.cfs_period_us": f"{period}\n"},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("max 100000\n", 64), ("200000 100000\n", 2), ("150000 100000\n", 1), ("50000 100000\n", 1),
        ("1000 1000000\n", 1), ("9900000 100000\n", 64), ("", 64), ("x y\n", 64), ("100000\n", 64), ("0 0\n", 64),
    ],
)  # fmt: skip
def test_a_quota_of_version_2_holds_in_whole_cpus(tmp_path, many, text, count):
    assert usable_cpus(v2(tmp_path, text)) == count


@pytest.mark.parametrize(
    ("quota", "period", "count"), [(-1, 100000, 64), (300000, 100000, 3), (50000, 50000, 1), (70000, 50000, 1)]
)
def test_a_quota_of_version_1_holds_in_whole_cpus(tmp_path, many, quota, period, count):
    assert usable_cpus(v1(tmp_path, quota, period)) == count


def test_quotas_of_the_groups_above_hold_too_and_the_tightest_counts(tmp_path, many):
    root = v2(tmp_path, "800000 100000\n", own="/pod/box", at="pod/box/")
    assert usable_cpus(root) == 8
    (root / "sys/fs/cgroup/pod/cpu.max").write_text("300000 100000\n")
    assert usable_cpus(root) == 3
    assert cpu_quota(root) == 3.0
    (root / "sys/fs/cgroup/cpu.max").write_text("max 100000\n")
    assert usable_cpus(root) == 3


def test_a_container_that_sees_its_group_as_the_top(tmp_path, many):
    assert usable_cpus(v2(tmp_path, "400000 100000\n", own="/kubepods/a", mount="/kubepods/a")) == 4
    assert usable_cpus(v2(tmp_path, "400000 100000\n", own="/../../b", mount="/")) == 4
    assert usable_cpus(v1(tmp_path / "v1", 500000, 100000, own="/docker/ab", mount="/docker/other")) == 5


@pytest.mark.parametrize("text", ["", "nonsense", "0::/\n\x00", ":::::\n", "12 - cgroup2\n"])
def test_files_of_another_form_limit_nothing(tmp_path, many, text):
    assert usable_cpus(system(tmp_path, text, text)) == 64
    assert cpu_quota(tmp_path) is None


def test_no_such_files_at_all_limit_nothing(tmp_path, many):
    assert usable_cpus(tmp_path) == 64


def test_what_is_not_text_limits_nothing(tmp_path, many):
    root = v2(tmp_path, "max 100000\n")
    (root / "sys/fs/cgroup/cpu.max").write_bytes(b"\xff\xfe\x00")
    assert usable_cpus(root) == 64


@linux
def test_all_pools_take_the_quota_for_their_default(tmp_path, monkeypatch, dynamic):
    from gavatar_runtime import native_library as nl
    from gavatar_runtime.decoding.network import session_options

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(cpus, "ROOT", v2(tmp_path, "300000 100000\n"))
    assert session_options().intra_op_num_threads == 3
    assert session_options(2).intra_op_num_threads == 2
    if nl.available()[0]:
        nl.set_threads(0)
        assert nl.threads() == 3
        monkeypatch.undo()
        nl.set_threads(0)
        assert nl.threads() == usable_cpus()


@linux
@pytest.mark.skipif(not os.access("/sys/fs/cgroup/cpu", os.W_OK), reason="no control group can be made here")
def test_a_quota_that_the_kernel_keeps(tmp_path):
    group = f"/sys/fs/cgroup/cpu/gavatar_test_{os.getpid()}"
    try:
        os.mkdir(group)
    except OSError:
        pytest.skip("no control group can be made here")
    try:
        with open(f"{group}/cpu.cfs_quota_us", "w") as file:
            file.write("100000")
        script = f"import os; open({group!r} + '/cgroup.procs', 'w').write(str(os.getpid()))\n"
        script += "from gavatar_runtime.cpus import cpu_quota, usable_cpus; print(cpu_quota(), usable_cpus())"
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=child_environment())
        assert done.stdout == "1.0 1\n", done.stderr
    finally:
        os.rmdir(group)
