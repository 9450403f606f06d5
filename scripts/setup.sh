#!/usr/bin/env bash
# Make .venv with everything the product and its tests need. torch first, with plain pip: its CPU build differs by machine.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || {
  echo "Desire Path needs Python 3.11 (PyBullet has no wheels for newer ones); $python is $("$python" --version 2>&1)." >&2
  echo "Install it and run: make run PYTHON=python3.11" >&2
  exit 1
}
if [ ! -x .venv/bin/pip ]; then
  if ! "$python" -m venv .venv; then
    # Debian's python3.11 comes without ensurepip.
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
      apt-get update -qq && apt-get install -y -qq python3.11-venv
      "$python" -m venv --clear .venv
    else
      echo "Python's venv module is missing. On Debian or Ubuntu: sudo apt-get install python3.11-venv" >&2
      exit 1
    fi
  fi
fi
scripts/setup_node.sh --if-there &
node=$!
pip=(.venv/bin/pip install --quiet --disable-pip-version-check --no-compile)
torch_index=()
[ -n "${DESIREPATH_TORCH_INDEX:-}" ] && torch_index=(--index-url "$DESIREPATH_TORCH_INDEX")
echo "Installing torch ..."
"${pip[@]}" "${torch_index[@]}" torch==2.13.0
echo "Installing the rest ..."
scripts/install_locked.sh .venv/bin/python requirements.lock
"${pip[@]}" --no-deps --no-build-isolation --editable . --editable ./experiments
.venv/bin/pip check >/dev/null || { .venv/bin/pip check; exit 1; }
# On all cores; some packages bring templates that are no Python.
.venv/bin/python -m compileall -q -j 0 .venv/lib app backend experiments >/dev/null || true
wait "$node"
