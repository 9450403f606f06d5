#!/usr/bin/env bash
# The tests drive Debian's Chromium; nothing is downloaded from anywhere else. Its headless shell draws the same pages
# with a quarter of the work; where there is none, whole Chromium does.
set -euo pipefail
command -v chromium-headless-shell >/dev/null && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -qq || true
  apt-get install -y -qq chromium-headless-shell >/dev/null && exit 0
  command -v chromium >/dev/null || apt-get install -y -qq chromium >/dev/null
fi
command -v chromium >/dev/null && exit 0
echo "The tests need Chromium. On Debian: sudo apt-get install chromium-headless-shell" >&2
exit 1
