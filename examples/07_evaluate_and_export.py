"""Score a trained run and write its bundle: python examples/07_evaluate_and_export.py RUN anna.gavatar"""

import sys

import gavatar

directory, bundle = sys.argv[1:]
run = gavatar.open_run(directory)

evaluation = run.evaluate(fit_steps=0, perceptual=False)
for row in evaluation.rows:
    print(f"{row.split}, {row.poses} poses: {row.psnr:.2f} dB, SSIM {row.ssim:.4f}")

print(run.export(bundle))  # verified against PyTorch before it is written
