#!/bin/sh
# Runs fuzz targets one after the other, each for so many seconds or a million inputs, whichever is first:
#   fuzz/run.sh SECONDS [TARGET...]
# Without targets: all of them. Those that link the server need libtorch (scripts/libtorch.sh). A find is left in
# fuzz/artifacts/TARGET and ends the run. Needs the nightly toolchain and cargo-fuzz.
set -eu
cd "$(dirname "$0")"
seconds=${1:?seconds for each target}
shift
cargo +nightly fuzz --version >/dev/null 2>&1 || {
    echo "fuzzing needs: rustup toolchain install nightly && cargo install cargo-fuzz --locked" >&2
    exit 1
}
plain="container foxglove ros2 json path cdr protobuf image"
linked="checkpoint observation wire"
[ $# -gt 0 ] || set -- $plain $linked
export LD_LIBRARY_PATH="$PWD/../.libtorch/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" OMP_NUM_THREADS=1
# Recordings are read from files: in memory, where there is such a place.
[ ! -w /dev/shm ] || export TMPDIR=/dev/shm
features() { case " $linked " in *" $1 "*) echo "--features server" ;; esac; }

for target; do
    # Safe Rust: panics, time and memory are what is looked for, and the sanitizers would only slow that down.
    # The target counts an input's processor time and memory itself; these limits stop what never comes back.
    # shellcheck disable=SC2046
    cargo +nightly fuzz run --sanitizer none $(features "$target") "$target" -- \
        -max_total_time="$seconds" -runs="${RUNS:-1000000}" -max_len="${MAX_LEN:-16384}" -timeout=60 \
        -rss_limit_mb=1500 -print_final_stats=1
done
