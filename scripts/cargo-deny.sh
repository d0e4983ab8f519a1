#!/usr/bin/env bash
# Asks cargo-deny whether every crate may be here: licences, sources, two versions of one, known weaknesses.
# Builds it once into the user's cache if there is none (some minutes).
set -euo pipefail
cd "$(dirname "$0")/.."

version=0.20.2
root="${XDG_CACHE_HOME:-$HOME/.cache}/gleaner/cargo-deny-$version"
if [ ! -x "$root/bin/cargo-deny" ]; then
  echo "cargo-deny: building $version, once"
  # Where it is built, no pinned toolchain and no flags of ours count.
  (cd "${TMPDIR:-/tmp}" && cargo install cargo-deny --version "$version" --locked --quiet --root "$root")
fi
# A build fetches the crates of this platform alone.
cargo fetch --locked --quiet
"$root/bin/cargo-deny" --offline check --hide-inclusion-graph bans licenses sources
# The list of known weaknesses is on the internet, where not every machine gets to.
if ! said=$("$root/bin/cargo-deny" check --hide-inclusion-graph advisories 2>&1); then
  case "$said" in
    *"failed to fetch advisory database"*) echo "advisories not checked: their list cannot be fetched from here" ;;
    *) echo "$said" >&2; exit 1 ;;
  esac
fi
