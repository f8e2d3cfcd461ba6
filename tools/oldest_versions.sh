#!/usr/bin/env bash
# Tries the oldest versions that pyproject.toml promises (the last patch of each): installs them with the package into a
# throw-away environment, asks pip whether they fit each other, and runs the tests of the player (or those given).
#
#     PYTHON=python3.10 tools/oldest_versions.sh [TEST ...]
#
# With torch's oldest wheel for Linux come three gigabytes of CUDA libraries; EXTRAS=video,dev leaves torch out.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

"${PYTHON:-python3.10}" -m venv "$folder/venv"
python=$folder/venv/bin/python
"$python" -m pip install --quiet --disable-pip-version-check tomli
"$python" - "${EXTRAS:-train,video,tensorboard,dev}" > "$folder/oldest.txt" <<'PYTHON'
import re, sys, tomli
project = tomli.load(open("pyproject.toml", "rb"))["project"]
needs = project["dependencies"] + [n for e in sys.argv[1].split(",") for n in project["optional-dependencies"][e]]
print(*sorted({re.sub(r">=", "~=" if n.count(".") == 0 else "==", n) for n in needs}), sep="\n")
PYTHON
sed -i 's/~=\([0-9]*\)$/==\1.*/; s/==\([0-9]*\.[0-9]*\)$/==\1.*/; s/==\([0-9]*\)$/==\1.*/' "$folder/oldest.txt"
cat "$folder/oldest.txt"
"$python" -m pip install --quiet --disable-pip-version-check -r "$folder/oldest.txt" -e .
"$python" -m pip check
OMP_NUM_THREADS=1 "$python" -m pytest -q -p no:cacheprovider "${@:-tests/runtime}"
