"""A motion made of arrays: the right arm goes up. python examples/04_... anna.gavatar anna.png"""

import sys

import numpy as np

import gavatar_runtime as gr
from gavatar_runtime.values.skeletons import SMPLH

bundle, out = sys.argv[1:]
frames, shoulder = 30, SMPLH.index("right_shoulder")
poses = np.zeros((frames, len(SMPLH), 3))
poses[:, shoulder, 2] = np.linspace(1.2, -1.2, frames)  # radians about z, relative to the collar
poses[:, SMPLH.index("left_shoulder"), 2] = -1.2

motion = gr.Motion(poses=poses, trans=np.zeros((frames, 3)), fps=30.0, name="salute")
gr.load(bundle).play(motion, out)
