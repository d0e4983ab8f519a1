#!/usr/bin/env bash
# Loading of batches beside PyTorch's DataLoader and LeRobot, in one run: run.sh PROGRAM ARGUMENTS… runs loading.py or
# torch_dataset.py; see README.md.
#
# BENCH_PROFILE is cargo's profile (bench), LOADING_VENV where the virtual environment is or shall be.
set -euo pipefail
cd "$(dirname "$0")/../.."
program="${1:?name loading.py or torch_dataset.py}"
shift

. benches/programs.sh
build

venv="${LOADING_VENV:-${XDG_CACHE_HOME:-$HOME/.cache}/gleaner/loading}"
[ -e "$venv/bin/python" ] || python3 -m venv "$venv"
echo "loading: LeRobot and PyTorch in $venv (the first time about 8 GB)" >&2
pip="$venv/bin/python -m pip install --quiet --disable-pip-version-check"
$pip --require-hashes --only-binary=:all: --no-binary=evdev -r benches/loading/requirements.lock
$pip --no-deps client/python

# Other load on the machine affects times more than ratios.
uptime
PYTHONPATH=benches/lab exec "$venv/bin/python" -B "benches/loading/$program" --bin "$folder" "$@"
