#!/usr/bin/env bash
# Install what a lock file pins into the environment of PYTHON: install_locked.sh PYTHON LOCK. With uv, itself pinned in
# requirements.lock, which fetches and unpacks side by side; where it cannot be had or fails, pip does the same.
set -euo pipefail
cd "$(dirname "$0")/.."
pip=(.venv/bin/pip --python "$1")
locked=(--quiet --no-deps --require-hashes)
pinned_uv=$(mktemp)
trap 'rm -f "$pinned_uv"' EXIT
sed -n '/^uv==/,/[^\\]$/p' requirements.lock > "$pinned_uv"
# uv does not read pip's configuration.
index=$(.venv/bin/pip config get global.index-url 2>/dev/null || true)
[ -x .venv/bin/uv ] || .venv/bin/pip install "${locked[@]}" --disable-pip-version-check -r "$pinned_uv" || true
index=${UV_DEFAULT_INDEX:-${PIP_INDEX_URL:-$index}}
[ -z "$index" ] || export UV_DEFAULT_INDEX="$index"
.venv/bin/uv pip install --python "$1" "${locked[@]}" -r "$2" ||
  "${pip[@]}" install "${locked[@]}" --no-compile --disable-pip-version-check -r "$2"
