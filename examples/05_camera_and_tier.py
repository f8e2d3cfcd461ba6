"""The same frame by every stored tier, from the left: python examples/05_camera_and_tier.py anna.gavatar FOLDER"""

import sys
from pathlib import Path

import numpy as np

import gavatar_runtime as gr
from gavatar_runtime.formats.png import write_png
from gavatar_runtime.tiers import stored_tiers

bundle, folder = sys.argv[1], Path(sys.argv[2])
folder.mkdir(parents=True, exist_ok=True)
pose = gr.read_motion("wave").poses[20]

whole = gr.load(bundle)
for tier in stored_tiers(whole.bundle):
    image = gr.load(bundle, tier=tier).render(pose, camera="left", size=512)
    write_png(folder / f"{tier}.png", image)
    error = np.sqrt(np.mean((image.astype(float) - whole.render(pose, camera="left", size=512)) ** 2))
    print(f"{tier}: {error:.3f} rms from full")
