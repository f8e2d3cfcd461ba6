"""The table of built-in motions in docs/reference/motions.md: how feet meet the floor, measured on the free body.

`motion_table.py` prints it; `motion_table.py --write docs/reference/motions.md` puts it between the marks in that file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from gavatar.measure.footing import footing
from gavatar_plugins.bodies.free import load_free_body
from gavatar_runtime.motions import read_motion
from gavatar_runtime.motions.fitting import scaled_to_legs

FPS = 60.0
# name, options as --set gives them, metres a second that the floor comes towards the person
CASES = (
    ("idle", {}, 0.0), ("walk", {}, 1.35), ("walk", {"speed": 0.6}, 0.6), ("walk", {"speed": 2.0}, 2.0),
    ("walk", {"travel": True}, 0.0), ("run", {}, 2.8), ("run", {"speed": 4.5}, 4.5), ("jump", {}, 0.0),
    ("jump", {"forward": 0.8}, 0.0), ("dance", {}, 0.0), ("stretch", {}, 0.0), ("wave", {}, 0.0),
)  # fmt: skip
BEGIN, END = "<!-- measured by tools/motion_table.py -->", "<!-- end -->"


def table() -> str:
    """Markdown, a row a case."""
    body = load_free_body()
    joints = body.shaped(None)[1]
    rows = [
        "| motion | stances | slide, the worst stance | on average | deepest below the floor | both feet off it |",
        "|---|---|---|---|---|---|",
    ]
    for name, options, floor in CASES:
        motion = scaled_to_legs(read_motion(name, fps=FPS, **options), body.joint_names, joints)
        f = footing(body, motion, floor_speed=floor)
        said = " ".join([name, *(f"{key}={str(value).lower()}" for key, value in options.items())])
        rows.append(
            f"| `{said}` | {f.stances} | {1000 * f.slide:.1f} mm | {1000 * f.mean_slide:.1f} mm "
            f"| {1000 * f.sunk:.1f} mm | {100 * f.flight:.0f} % |"
        )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="FILE.md")
    path = parser.parse_args().write
    made = table()
    print(made)
    if path:
        text = path.read_text()
        before, _, rest = text.partition(BEGIN)
        path.write_text(f"{before}{BEGIN}\n{made}\n{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
