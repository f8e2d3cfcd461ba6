"""One picture of an avatar: python examples/01_first_frame.py anna.gavatar anna.png"""

import sys

import gavatar_runtime as gr
from gavatar_runtime.formats.png import write_png

bundle, picture = sys.argv[1:]
avatar = gr.load(bundle)
print(avatar)  # its name, number of Gaussians, tiers

motion = gr.read_motion("wave")  # a built-in motion, or a file
pose = motion.poses[len(motion) // 2]  # (J, 3) axis-angle, radians
image = avatar.render(pose, size=512)  # (512, 512, 3); the camera frames the person
write_png(picture, image)
