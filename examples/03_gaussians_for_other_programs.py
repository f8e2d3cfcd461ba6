"""The Gaussians of one pose as a .ply that SuperSplat and others read: python examples/03_... anna.gavatar anna.ply"""

import sys

import numpy as np

import gavatar_runtime as gr

bundle, file = sys.argv[1:]
avatar = gr.load(bundle)
gaussians = avatar.gaussians(body_pose=np.zeros(63), transl=[0, 1, 0])  # the names of smplx
print(f"{len(gaussians)} Gaussians, {gaussians.means.min(0)} to {gaussians.means.max(0)} metres")
avatar.save(file, gr.read_motion("turn").poses[0])
