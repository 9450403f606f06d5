#!/usr/bin/env bash
# `make lint` checks the browser's modules with TypeScript, which needs Node; the editor of protocols is CodeMirror's modules,
# copied as they are. Versions are pinned in package.json, all of them, as there is no lock file: one would record where
# packages were fetched from. --if-there: where npm is missing or nothing answers it, pages do with a plain text field.
set -euo pipefail
cd "$(dirname "$0")/.."
if [ "${1:-}" = --if-there ]; then
  command -v npm >/dev/null && "$0" || echo "No CodeMirror: protocols are edited in a plain text field (Node, then: make node_modules/.ready)."
  exit 0
fi
if ! command -v npm >/dev/null; then
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends nodejs npm >/dev/null
  else
    echo "make lint needs Node and npm. On Debian: sudo apt-get install nodejs npm" >&2
    exit 1
  fi
fi
npm install --no-package-lock --ignore-scripts --no-audit --no-fund --loglevel=error
node scripts/browser_modules.mjs
