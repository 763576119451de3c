#!/usr/bin/env bash
# Formatting, clippy, lengths of files and functions, imports, sources of constants, and the borders
# between the crates.
set -euo pipefail
cd "$(dirname "$0")/.."
fail=0
complain() { echo "lint: $1" >&2; fail=1; }

cargo fmt --all -- --check || complain "run 'cargo fmt --all'"
cargo clippy --workspace --all-targets --locked -- -D warnings || complain "clippy has something to say"
RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked --quiet || complain "the documentation has warnings"

# Licences, registries and wildcards of the dependencies (deny.toml).
if cargo deny --version >/dev/null 2>&1; then
  cargo deny --offline --log-level error check licenses bans sources || complain "a dependency is not what deny.toml allows"
else
  echo "lint: cargo deny is not installed; licences and sources of dependencies are not checked" >&2
fi

while read -r lines file; do
  [ "$lines" -gt 500 ] && complain "$file has $lines lines; 500 is the most"
done < <(git ls-files '*.rs' '*.wgsl' '*.cc' '*.h' '*.py' '*.sh' '*.js' '*.ts' | xargs wc -l | grep -v ' total$')

python3 tools/structure.py --check || complain "the structure has got worse"
python3 tools/benchmarks_page.py docs/results --out docs/benchmarks.md --check || complain "docs/benchmarks.md is not what docs/results says"

python3 tools/reliability/page.py docs/results --out docs/reliability.md --check || complain "docs/reliability.md is not what docs/results says"

# The arithmetic of the suite of rendered captures; where `python3` has no numpy, Debian's has.
python=python3
$python -c "import numpy" 2>/dev/null || python=/usr/bin/python3
$python -m unittest discover -q -s tools/suite || complain "tools/suite fails its tests"

# The stage crates know `scene` and nothing of each other, `baselines` and `lighting` also `splat`; native libraries
# stay in their corner.
for crate in scene preprocess sfm splat stereo shape; do
  for other in preprocess sfm splat stereo shape lighting sat_recon; do
    [ "$crate" = "$other" ] && continue
    git grep -nE "^$other\b" -- "$crate/Cargo.toml" && complain "$crate must not know $other"
  done
done
for other in preprocess sfm stereo shape lighting sat_recon; do
  git grep -nE "^$other\b" -- baselines/Cargo.toml && complain "baselines must not know $other"
done
for other in preprocess sfm stereo shape baselines sat_recon; do
  git grep -nE "^$other\b" -- lighting/Cargo.toml && complain "lighting must not know $other"
done
git grep -nE '\bcxx::' -- '*.rs' ':!sfm/src/ceres' ':!sfm/build.rs' && complain "cxx belongs to sfm/src/ceres"
git grep -nE '\bwgpu::' -- '*.rs' ':!splat/src/gpu' ':!baselines/src/gpu/device.rs' && complain "wgpu belongs to splat/src/gpu and baselines/src/gpu/device.rs"
git grep -nE '\bmeshopt::' -- '*.rs' ':!shape/src/decimate.rs' && complain "meshopt belongs to shape/src/decimate.rs"
git grep -nE 'todo!\(|unimplemented!\(|dbg!\(|#\[ignore' -- '*.rs' && complain "something was left undone"
git grep -nE '^[^/]*(println!|print!\(|eprintln!)' -- 'scene/src' 'preprocess/src' 'sfm/src' 'splat/src' 'stereo/src' 'shape/src' 'baselines/src' 'lighting/src' ':!*tests.rs' ':!*/tests/*' ':!splat/src/parity' && complain "libraries never print"
exit $fail
