"""A video of a motion: python examples/02_video.py anna.gavatar wave anna.mp4 (or frames/, or a .png contact sheet)"""

import sys

import gavatar_runtime as gr

bundle, motion, out = sys.argv[1:]
avatar = gr.load(bundle)
report = avatar.play(motion, out, fps=30)  # as gavatar-play does
print(report)
