#!/usr/bin/env bash
# Bundles viewer/ into viewer/dist/viewer.js, which the program takes in when it is built.
set -euo pipefail
cd "$(dirname "$0")/../viewer"
if ! command -v npm >/dev/null; then
  echo "npm is missing: building without the web viewer (install Node.js 20 or newer and run make again to have it)" >&2
  exit 0
fi
newest=$(ls -t src/*.js package-lock.json dist/viewer.js 2>/dev/null | head -n 1 || true)
[ "$newest" = dist/viewer.js ] && [ -d node_modules/puppeteer-core ] && exit 0
if ! { npm ci --no-audit --no-fund --loglevel=error && npm run --silent build -- --log-level=warning; }; then
  echo "npm could not bundle the web viewer (see above): building without it" >&2
fi
