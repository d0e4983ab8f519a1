#!/bin/sh
# Runs fuzz targets one after the other, each for SECONDS or a million inputs, whichever ends first:
#   fuzz/run.sh SECONDS [TARGET...]
# Without TARGET: all of them. Those that link the server need libtorch (scripts/libtorch.sh). A finding is written to
# fuzz/artifacts/TARGET and ends the run. Needs the nightly toolchain and cargo-fuzz.
#
# Each target starts with fuzz/corpus/TARGET, which is in the repository, and with the inputs of earlier runs in
# fuzz/growth/TARGET, which is not. KEEP=1 adds the inputs of up to KEEP_BYTES (2048) that reach new code to
# fuzz/corpus/TARGET; commit them. The differential suite (`make differential-test CORPUS=…`) adds damaged
# recordings to fuzz/corpus/container.
set -eu
cd "$(dirname "$0")"
seconds=${1:?seconds for each target}
shift
cargo +nightly fuzz --version >/dev/null 2>&1 || {
    echo "fuzzing needs: rustup toolchain install nightly && cargo install cargo-fuzz --locked" >&2
    exit 1
}
plain="container foxglove ros2 json path cdr protobuf image"
datasets="dataset"
linked="checkpoint observation wire"
[ $# -gt 0 ] || set -- $plain $datasets $linked
export LD_LIBRARY_PATH="$PWD/../.libtorch/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" OMP_NUM_THREADS=1
# Recordings are read from files, which are in memory where that is possible, in a folder of this run alone.
[ ! -w /dev/shm ] || TMPDIR=/dev/shm
TMPDIR=$(mktemp -d "${TMPDIR:-/tmp}/gleaner-fuzz.XXXXXX")
export TMPDIR
trap 'rm -rf "$TMPDIR"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
features() {
    case " $datasets " in *" $1 "*) echo "--features datasets" ;; esac
    case " $linked " in *" $1 "*) echo "--features server" ;; esac
}

for target; do
    # The code is safe Rust, so the search is for panics, time and memory, and sanitizers would slow it down. The target
    # measures the processor time and memory of an input itself; these limits end inputs that never return.
    mkdir -p "growth/$target" "corpus/$target"
    # shellcheck disable=SC2046
    cargo +nightly fuzz run --sanitizer none $(features "$target") "$target" "growth/$target" "corpus/$target" -- \
        -max_total_time="$seconds" -runs="${RUNS:-1000000}" -max_len="${MAX_LEN:-16384}" -timeout=60 \
        -rss_limit_mb=1500 -print_final_stats=1
    [ -n "${KEEP:-}" ] || continue
    # shellcheck disable=SC2046
    cargo +nightly fuzz run --sanitizer none $(features "$target") "$target" "corpus/$target" "growth/$target" -- \
        -merge=1 -max_len="${KEEP_BYTES:-2048}" -rss_limit_mb=1500
done
