"""Train an avatar of a capture: python examples/06_train.py CAPTURE RUN [setting=value ...]"""

import sys

import gavatar

capture, run_directory, *settings = sys.argv[1:]
overrides = dict(setting.split("=", 1) for setting in settings)

# any setting of gavatar-train; a wrong one is refused before work starts
run = gavatar.train(capture, preset="demo", encoder="none", out=run_directory, **overrides)
print(run)  # given again after it was stopped, it goes on
