#!/usr/bin/env bash
# Installs the Debian packages named as arguments that are missing, and checks the Rust toolchain.
set -euo pipefail

if ! command -v cargo >/dev/null; then
  echo "cargo is missing: install a Rust toolchain (rustc 1.89 or newer), for instance with rustup, and run make again" >&2
  exit 1
fi
version=$(rustc --version | awk '{print $2}')
if [ "$(printf '%s\n' 1.89.0 "${version%%-*}" | sort -V | head -n 1)" != 1.89.0 ]; then
  echo "rustc $version is too old: sat-recon needs 1.89 or newer ('rustup update stable')" >&2
  exit 1
fi

missing=()
for package in "$@"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0

if ! command -v apt-get >/dev/null; then
  echo "not a Debian system: install the equivalents of ${missing[*]} by hand, then run make again" >&2
  exit 1
fi
as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "run as root, or install sudo: ${missing[*]} must be installed" >&2; exit 1; }
  as_root=(sudo)
fi
echo "installing ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
