#!/usr/bin/env bash
# Bundles viewer/ into viewer/viewer.js.gz, which the program takes in when it is built. It is kept
# in the repository, so that the program has its viewer where Node.js is missing; the sums beside it
# say of which sources it is (a test compares them).
set -euo pipefail
cd "$(dirname "$0")/../viewer"
sums() { sha256sum src/*.js package-lock.json package.json; }
# What is installed may be of an older list of packages.
if sums | cmp -s - viewer.sums && sums | cmp -s - node_modules/.sums; then
  exit 0
fi
if ! command -v npm >/dev/null; then
  sums | cmp -s - viewer.sums || echo "npm is missing: the web viewer stays as it was bundled last (install Node.js 20 or newer and run make again)" >&2
  exit 0
fi
if ! { npm ci --no-audit --no-fund --loglevel=error && npm run --silent build -- --log-level=warning; }; then
  echo "npm could not bundle the web viewer (see above): it stays as it was bundled last" >&2
  exit 0
fi
gzip -9nc dist/viewer.js > viewer.js.gz
sums | tee viewer.sums > node_modules/.sums
