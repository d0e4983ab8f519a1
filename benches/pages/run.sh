#!/usr/bin/env bash
# Builds the server and asks for every page on a large lab's database. Arguments go to pages.py.
#
# BENCH_PROFILE is cargo's profile (bench).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/programs.sh
build gleaner-cli
exec python3 benches/pages/pages.py --bin "$folder" "$@"
