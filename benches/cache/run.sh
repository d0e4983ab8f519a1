#!/usr/bin/env bash
# Builds the programs and measures the size of decoded steps beside that of their recordings. Arguments go to sizes.py.
#
# BENCH_PROFILE is cargo's profile (bench), CACHE_VENV where the virtual environment is or shall be.
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/programs.sh
build gleaner-cli

venv="${CACHE_VENV:-${XDG_CACHE_HOME:-$HOME/.cache}/gleaner/cache}"
[ -e "$venv/bin/python" ] || python3 -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: -r benches/cache/requirements.in

PYTHONPATH=benches/lab:benches/loading exec "$venv/bin/python" -B benches/cache/sizes.py --bin "$folder" "$@"
