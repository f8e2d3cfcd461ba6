"""The page's scripts, run by node."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np

from gavatar_runtime.web.look import StillLook
from gavatar_runtime.web.page import MOTION_FILES, PLAYER, script


def run(folder: Path, code: str, **given) -> list:
    """What `return` of the code gives, in one scope with the player; `given` is an object there."""
    text = script((*PLAYER, *MOTION_FILES))
    values = json.dumps(given, default=lambda a: np.asarray(a, np.float64).ravel().tolist())
    path = folder / "it.mjs"
    path.write_text(
        f"import {{ readFileSync }} from 'node:fs';\n{text}\nconst given = {values};\n"
        f"const out = await (async () => {{ {code} }})();\nconsole.log(JSON.stringify(out));"
    )
    done = subprocess.run(["node", str(path)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def joints_of(look: StillLook) -> dict:
    """A skeleton as the header of a page has it."""
    return {"names": look.joint_names, "parents": look.parents.tolist(), "rest": look.rest, "inverse": look.inverse}


def read_by_the_page(folder: Path, look: StillLook, files: list[Path]) -> list[dict]:
    """Of each motion file {name, fps, poses (T, J, 3), trans (T, 3), notes}, or {error}."""
    got = run(
        folder,
        "const out = []; for (const path of given.files) {"
        "const file = { name: path.replace(/^.*\\//, ''),"
        "arrayBuffer: async () => new Uint8Array(readFileSync(path)).buffer };"
        "try { const m = await readMotionFile(file, given.body, Float32Array.from(given.relaxed));"
        "const { name, fps, notes } = m;"
        "out.push({ name, fps, poses: Array.from(m.poses), trans: Array.from(m.trans), notes });"
        "} catch (error) { out.push({ error: error.message }); } } return out;",
        files=[str(path) for path in files], body=joints_of(look), relaxed=look.relaxed,
    )  # fmt: skip
    for one in got:
        if "error" not in one:
            one["poses"] = np.reshape(one["poses"], (-1, len(look.joint_names), 3))
            one["trans"] = np.reshape(one["trans"], (-1, 3))
    return got
