#!/bin/sh
# Builds the groups of ranks with a CUDA build of libtorch and NCCL, from PyTorch's wheels, and runs their tests. A GPU is
# not needed: without one the tests show that its absence is a clear error. Takes 6 GB below target/nccl and ten minutes.
#   scripts/check_nccl.sh
set -eu
cd "$(dirname "$0")/.."
environment=target/nccl/python
if [ ! -x "$environment/bin/python" ]; then
    "${PYTHON:-python3}" -m venv "$environment"
fi
# The wheels that PyTorch needs lack two packages of headers.
"$environment/bin/pip" install --quiet "torch==$(sed -n 's/^version=//p' scripts/libtorch.sh)"
"$environment/bin/pip" install --quiet --no-deps 'nvidia-cuda-crt==13.0.*' 'nvidia-cuda-cccl==13.0.*'
libraries=$("$environment/bin/python" -c 'import os, torch; print(os.path.join(os.path.dirname(torch.__file__), "lib"))')
PATH="$PWD/$environment/bin:$PATH" LIBTORCH_USE_PYTORCH=1 LD_LIBRARY_PATH="$libraries" CARGO_TARGET_DIR=target/nccl/build \
    ${CARGO:-cargo} test --locked -p gleaner-group -- --nocapture
