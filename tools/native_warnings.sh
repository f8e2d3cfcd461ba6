#!/bin/sh
# The native kernel without a warning, by every compiler that is here: the library, and each header by itself.
#   PYTHON=python3 tools/native_warnings.sh
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
export PYTHONPATH=".${PYTHONPATH:+:$PYTHONPATH}" PYTHONDONTWRITEBYTECODE=1
"$PYTHON" -c 'import pathlib, sys, setup; setup.write_rule(pathlib.Path(sys.argv[1]))' "$WORK"
for compiler in g++ clang++; do
    command -v $compiler > /dev/null || { echo "warnings: $compiler is not installed, not run"; continue; }
    CXX=$compiler "$PYTHON" -c 'import pathlib, sys, setup; setup.compile_library(pathlib.Path(sys.argv[1]), ["-Werror"])' \
        "$WORK/$compiler.so"
    for header in deploy/native/*.h; do
        $compiler -std=c++17 -Wall -Wextra -Werror -Wno-unused-function -fsyntax-only -I"$WORK" -Ideploy/native \
            -DGV_NAMESPACE=alone -include "$(basename "$header")" -x c++ /dev/null
    done
    echo "warnings: none from $($compiler --version | head -n 1), headers complete"
done
