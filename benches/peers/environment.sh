# Sourced by the peers' scripts: makes the virtual environment if there is none, and names its Python.
# PEERS_VENV is where it is or shall be.
venv="${PEERS_VENV:-${XDG_CACHE_HOME:-$HOME/.cache}/gleaner/peers}"
python="$venv/bin/python"
[ -e "$python" ] || python3 -m venv "$venv"
echo "peers: PyTorch in $venv (the first time about 3 GB)" >&2
"$python" -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --only-binary=:all: \
  -r benches/peers/requirements.lock
