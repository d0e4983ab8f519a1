#!/usr/bin/env bash
# Puts libtorch where cargo expects it: .libtorch -> a directory in the user's cache.
#
# tch 0.24 wants libtorch 2.11.0 exactly. The package index's wheel is the CUDA build; without a GPU
# only libtorch_cpu, libc10, libgomp and two small CUDA libraries that libtorch_cpu names are needed.
# Each wheel is checked by its SHA-256 digest, which benches/peers/requirements.lock has too.
# A second run does nothing. GLEANER_LIBTORCH=DIR links an existing libtorch 2.11 instead.
set -euo pipefail
cd "$(dirname "$0")/.."

version=2.11.0
cache="${GLEANER_LIBTORCH:-${XDG_CACHE_HOME:-$HOME/.cache}/gleaner/libtorch-$version-cpu}"

link() {
  ln -sfn "$1" .libtorch
}

if [ -e "$cache/lib/libtorch.so" ] && [ -d "$cache/include" ]; then
  link "$cache"
  exit 0
fi
if [ -n "${GLEANER_LIBTORCH:-}" ]; then
  echo "libtorch: $cache holds no lib/libtorch.so and include/; GLEANER_LIBTORCH must name a libtorch $version" >&2
  exit 1
fi

python=$(command -v python3 || command -v python) || { echo "libtorch: Python 3 with pip is needed to fetch it" >&2; exit 1; }
mkdir -p "$(dirname "$cache")"
work=$(mktemp -d "$(dirname "$cache")/fetch.XXXXXX")
trap 'rm -rf "$work"' EXIT

echo "libtorch: fetching $version (about 540 MB, once) ..." >&2
cat >"$work/wheels.txt" <<LOCK
torch==$version --hash=sha256:7aa2f9bbc6d4595ba72138026b2074be1233186150e9292865e04b7a63b8c67a
nvidia-cuda-runtime==13.0.96 --hash=sha256:7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548
nvidia-cuda-cupti==13.0.85 --hash=sha256:4eb01c08e859bf924d222250d2e8f8b8ff6d3db4721288cf35d14252a4d933c8
LOCK
# Any CPython's wheel serves, since only lib/ and include/ are used: so name one that exists.
"$python" -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: --require-hashes \
  --python-version 3.11 --implementation cp --platform manylinux_2_28_x86_64 --platform manylinux_2_25_x86_64 \
  --platform manylinux_2_17_x86_64 --platform manylinux2014_x86_64 \
  -d "$work/wheels" -r "$work/wheels.txt"

"$python" - "$work" <<'PY'
import pathlib, sys, zipfile

work = pathlib.Path(sys.argv[1])
lib, include = work / "tree/lib", work / "tree/include"
lib.mkdir(parents=True)
wanted = {"libtorch_cpu.so", "libc10.so", "libgomp.so.1", "libcudart.so.13", "libcupti.so.13"}
for wheel in (work / "wheels").glob("*.whl"):
    with zipfile.ZipFile(wheel) as z:
        for name in z.namelist():
            path = pathlib.PurePosixPath(name)
            if path.name in wanted:
                target = lib / path.name
            elif name.startswith("torch/include/") and not name.endswith("/"):
                target = include / path.relative_to("torch/include")
            else:
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with z.open(name) as source, open(target, "wb") as out:
                while chunk := source.read(1 << 20):
                    out.write(chunk)
            wanted.discard(path.name)
if wanted:
    sys.exit(f"libtorch: the wheels lack {sorted(wanted)}")
PY

# The wheel's libtorch.so pulls in CUDA; ours is an umbrella over the CPU library alone.
echo '' | "${CXX:-c++}" -x c++ -shared -o "$work/tree/lib/libtorch.so" - \
  -L"$work/tree/lib" -Wl,--no-as-needed -ltorch_cpu -lc10 -Wl,-rpath,'$ORIGIN' -Wl,--allow-shlib-undefined

rm -rf "$cache"
mv "$work/tree" "$cache"
link "$cache"
echo "libtorch: ready in $cache" >&2
