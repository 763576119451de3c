# Everything is reached from here: `make demo` and `make test` set up what is missing.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

PACKAGES := pkg-config g++ libceres-dev libsqlite3-dev ffmpeg mesa-vulkan-drivers
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/sat-recon
# In CI the checkout is fresh each time: the build products live in the user's cache.
ifneq ($(CI),)
export CARGO_TARGET_DIR ?= $(CACHE)/target
endif
TARGET := $(or $(CARGO_TARGET_DIR),target)
SAT_RECON := $(TARGET)/release/sat-recon
VENV := $(CACHE)/venv
SHARED := $(or $(SAT_RECON_SHARED),../shared)
# Where another Python comes first on the PATH, Debian's has numpy.
PYTHON_NUMPY := $(shell python3 -c 'import numpy' 2>/dev/null && echo python3 || echo /usr/bin/python3)

.PHONY: help setup viewer build demo wheel first-picture container readers readers-nerfstudio test reliability reliability-page crash-test cluster-test fuzz sanitize arm64 neon lint same-bytes bench tables bench-gpu compare skips benchmarks-page oracle testbed suite bench-suite bench-parts bench-relight plausibility site \
  tutorial-pictures
help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 20

setup:  ## install what is missing (Debian packages; as root or with sudo)
	@tools/setup.sh $(PACKAGES)

viewer:  ## bundle the web viewer where its sources have changed (needs Node.js)
	@tools/viewer.sh

build: setup viewer  ## build the release binary
	cargo build --release --locked

demo: build  ## a satellite that yaws before a green screen: video to splat, then say what to open
	$(SAT_RECON) data/testbed/case3/video.mp4 -o out/demo --quality draft
	@echo; echo "Open out/demo/report.html in a browser; the splat is out/demo/splat.ply, in a browser out/demo/view.html"

wheel: build  ## a Python wheel with the program inside: build/wheels (needs Python 3.9 with pip)
	@tools/setup.sh python3-venv binutils
	tools/wheel.sh $(SAT_RECON) build/wheels

# PYTHON311: prefix of a CPython 3.11, for a system that is like the image python:3.11.
first-picture: wheel  ## seconds from nothing to the first picture on bare machines, with the wheel (as root)
	@tools/setup.sh debootstrap python3
	python3 tools/first_picture.py build/wheels/*.whl data/sample/orbit.mp4 --out build/first_picture \
	    --results build/first_picture/results $(if $(PYTHON311),--python $(PYTHON311))
	@$(MAKE) benchmarks-page

container: build  ## the Dockerfile built and run; where no engine runs, as a root file system in a chroot (as root)
	@tools/setup.sh debootstrap binutils
	tools/container.sh $(SAT_RECON) build/container

# What other programs make of the demo's results; the packages stay in the user's cache.
readers: build $(VENV)/pycolmap  ## readers of others (pycolmap, splat-transform, gltf-validator) on our files
	@tools/setup.sh nodejs npm
	[ -d out/demo/eval ] || $(MAKE) demo
	npm install --no-audit --no-fund --loglevel=error --prefix $(CACHE)/readers @playcanvas/splat-transform@2.7.1 gltf-validator@2.0.0-dev.3.10
	$(VENV)/bin/python tools/readers.py $(SAT_RECON) out/demo --out build/readers --npm $(CACHE)/readers

# nerfstudio's own list of packages is longer than what its parsers need, and partly out of date.
PARSERS := torch open3d-cpu jaxtyping tyro viser==0.2.7 rich requests matplotlib tensorboard absl-py \
    appdirs rawpy opencv-python-headless imageio pillow
readers-nerfstudio: build  ## nerfstudio's own parsers on the demo's sets (downloads torch: 5 GB)
	@tools/setup.sh python3-venv
	[ -d out/demo/eval ] || $(MAKE) demo
	[ -x $(CACHE)/nerfstudio/bin/python ] || python3 -m venv $(CACHE)/nerfstudio
	$(CACHE)/nerfstudio/bin/pip install -q $(PARSERS)
	$(CACHE)/nerfstudio/bin/pip install -q --no-deps nerfstudio==1.1.5
	$(CACHE)/nerfstudio/bin/python -W ignore tools/nerfstudio_reader.py $(SAT_RECON) out/demo --out build/readers_nerfstudio

test: setup viewer  ## every test (real data is looked for in ../shared/data)
	@tools/setup.sh colmap chromium python3-numpy
	cargo test --workspace --locked

crash-test: build  ## kill the program, fill its disk and fail its reads at every call to the file system (hours)
	@tools/setup.sh python3 python3-numpy ffmpeg gcc
	$(PYTHON_NUMPY) tools/reliability/crashes.py $(SAT_RECON) --out build/reliability/crashes --results docs/results/crashes.json
	$(MAKE) reliability-page

reliability: build  ## wrong models, degenerate scenes, odd flags; docs/reliability.md from what came of them (half an hour)
	@tools/setup.sh python3 python3-numpy ffmpeg
	$(PYTHON_NUMPY) tools/reliability/flags.py $(SAT_RECON) --results docs/results/flags.json
	$(PYTHON_NUMPY) tools/reliability/scenes.py $(SAT_RECON) --out build/reliability/scenes --results docs/results/scenes.json
	$(PYTHON_NUMPY) tools/reliability/resources.py $(SAT_RECON) --out build/reliability/resources --results docs/results/resources.json
	$(PYTHON_NUMPY) tools/reliability/models.py $(SAT_RECON) --out build/reliability/models --results docs/results/models.json
	$(MAKE) reliability-page

reliability-page:  ## docs/reliability.md from docs/results
	python3 tools/reliability/page.py docs/results --out docs/reliability.md

cluster-test: build  ## 40 captures on Slurm's own daemons, four nodes here, one of them killed (as root; slow)
	@tools/setup.sh slurm-wlm munge python3-venv ffmpeg
	tools/cluster_test.sh $(SAT_RECON) build/cluster

# TIME: seconds for all targets together; TARGET="spz ksplat": some of them.
fuzz: setup  ## feed every reader of files with mutated files (TIME=60 seconds, TARGET=...)
	cargo run --profile fuzz --locked -p fuzz -- $(or $(TIME),60) --results docs/results/fuzz.json $(TARGET)

# Nightly Rust brings the sanitizer and Miri; they and Valgrind see this project's code and its dependencies.
sanitize: setup  ## readers, kernels and Ceres' border under Valgrind and sanitizers, Miri, advisories (what is installed of them)
	@tools/setup.sh valgrind
	python3 tools/reliability/sanitize.py --out build/sanitize --seconds $(or $(TIME),60) --results docs/results/sanitize.json
	$(MAKE) reliability-page

arm64:  ## the whole program and its wheel for 64-bit ARM, cross-built and run on an emulated processor (slow)
	@tools/setup.sh g++-aarch64-linux-gnu binutils-aarch64-linux-gnu mmdebstrap qemu-user-static python3-venv ffmpeg
	tools/arm64.sh build/arm64 build run wheel

# The trainer alone needs no other library for that processor.
ARM := aarch64-unknown-linux-gnu
neon: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER := aarch64-linux-gnu-gcc
neon: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER := qemu-aarch64-static -L /usr/aarch64-linux-gnu
neon:  ## the trainer's kernels as compiled for ARM (NEON) against the reference, on an emulated processor (slow)
	@tools/setup.sh gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static
	rustup target add $(ARM)
	cargo test -p splat --no-default-features --target $(ARM) --locked --lib -- cpu::
	cargo test -p splat --no-default-features --target $(ARM) --locked --lib -- \
	    parity::kernels parity::pictures parity::adam parity::scores parity::steps parity::extreme --skip two_hundred --skip ten_thousand --skip hundred_thousand

lint: setup  ## formatting, clippy, lengths, imports, sources of constants, borders between crates
	@tools/setup.sh python3 python3-numpy; tools/lint.sh

same-bytes: build  ## results of this program against those recorded for BASE (a commit), on this machine
	@tools/setup.sh python3
	python3 tools/same_bytes.py $(SAT_RECON) $(SHARED) --out build/same_bytes $(if $(BASE),--against $(BASE))

EXAMPLES := ring_growth key_table features_table ablation step_cost growth
bench: build  ## all benchmarks on real data, and docs/benchmarks.md from their results (hours)
	cargo build --release --locked --workspace $(EXAMPLES:%=--example %)
	@tools/setup.sh python3-numpy python3-pil colmap
	$(PYTHON_NUMPY) tools/bench.py $(SAT_RECON) $(SHARED) --out build/bench --plot docs/speed_accuracy.svg
	@$(MAKE) benchmarks-page

# LIMIT: the same wall time for each training, for instance LIMIT=5m (default: the steps of the preset).
tables: build  ## the paper's three tables, its rows beside them (slow; METHODS="3dgs instant-ngp", LIMIT=5m, CLOCK=processor)
	@tools/setup.sh python3
	python3 tools/paper_tables.py $(SAT_RECON) $(SHARED) --out build/tables \
	    $(if $(METHODS),--methods $(METHODS)) $(if $(LIMIT),--time-limit $(LIMIT)) $(if $(CLOCK),--limit-clock $(CLOCK))

# SEEDS: runs with all steps, whose range is the scatter.
skips: build  ## what each step of the reconstruction is worth: every capture with each step left out (hours)
	@tools/setup.sh python3
	python3 tools/bench_skips.py $(SAT_RECON) $(SHARED) --out build/skips --seeds $(or $(SEEDS),5)

benchmarks-page:  ## docs/benchmarks.md from the results in build/ and docs/results
	python3 tools/benchmarks_page.py docs/results $(wildcard build/*/results) --out docs/benchmarks.md --keep docs/results

# --workspace: alone the crate would resolve to fewer features of its dependencies, and wgpu would be compiled again.
bench-gpu: build  ## what needs a graphics card, in under ten minutes, as JSON (a small dry run without one)
	@tools/setup.sh python3
	cargo build --release --locked --workspace --example bench_gpu
	python3 tools/bench_gpu.py $(TARGET)/release/examples/bench_gpu $(SHARED) --out build/bench_gpu.json --sat-recon $(SAT_RECON)
	python3 tools/bench_gpu_tables.py build/bench_gpu.json --out build/bench_gpu/results

compare: build $(VENV)/pycolmap  ## our poses beside COLMAP 3.8 and 4.2.1 on the same images (slow)
	@tools/setup.sh colmap
	@$(VENV)/bin/python tools/compare.py $(SAT_RECON) $(SHARED) --out build/compare

oracle: $(VENV)/oracle  ## regenerate the fixtures that other libraries computed (downloads several GB)
	@for script in tests/oracle/*.py; do echo "$$script"; $(VENV)/bin/python $$script $(SHARED)/data build/oracle; done
	@$(VENV)/bin/python tests/oracle/fields.py --table; $(MAKE) benchmarks-page

testbed: setup  ## render the simulated captures with Blender (slow)
	@tools/setup.sh blender python3-numpy ffmpeg draco
	bash data/testbed/make.sh build/testbed
	mkdir -p build/testbed/blue && ln -sfn ../renders build/testbed/blue/renders
	BLUE=1 bash data/testbed/make.sh build/testbed/blue case3 case4

# NAME: parts of captures' names, for instance NAME="mockup-yaw -tumble-sun-15".
suite: $(VENV)/pycolmap  ## film rendered captures with truth (slow; NAME=... a part, SMALL=1 the first few of each class)
	@tools/setup.sh chromium ffmpeg
	$(VENV)/bin/python tools/suite/suite.py $(SHARED) $(NAME) $(if $(SMALL),--small)
	$(if $(NAME),,$(VENV)/bin/python tools/suite/wrong.py $(SHARED))

bench-suite: build $(VENV)/pycolmap  ## poses of all captures that `make suite` has filmed, judged, by class (NAME=..., COLMAP=1)
	$(VENV)/bin/python tools/suite/bench_suite.py $(SAT_RECON) --out build/suite $(if $(NAME),--only $(NAME)) $(if $(COLMAP),--colmap)

bench-parts: build $(VENV)/pycolmap  ## moving parts of the videos that `make suite` has filmed (NAME=... a part of names)
	$(VENV)/bin/python tools/suite/bench_parts.py $(SAT_RECON) $(SHARED) $(NAME) --out build/parts --splat --video $(SHARED)/data/phone_video/can_orbit.mp4

bench-relight: build  ## `render --light` against the test bed filmed with the lamp elsewhere (needs blender)
	@tools/setup.sh blender ffmpeg
	/usr/bin/python3 tools/bench_relight.py $(SAT_RECON) --out build/relight

plausibility: build $(VENV)/pycolmap  ## features of models, right and wrong, and the probability fitted to them (slow)
	$(VENV)/bin/python tools/plausibility/collect.py $(SAT_RECON) $(SHARED) --out build/plausibility --table docs/results/plausibility.csv
	$(VENV)/bin/python tools/plausibility/fit.py docs/results/plausibility.csv

$(VENV)/bin/python:
	@tools/setup.sh python3-venv
	python3 -m venv $(VENV)

$(VENV)/pycolmap: $(VENV)/bin/python
	$(VENV)/bin/pip install -q numpy pillow scipy pycolmap==4.2.1
	touch $@

$(VENV)/oracle: $(VENV)/bin/python
	$(VENV)/bin/pip install -q numpy pillow scipy scikit-image opencv-python-headless torch==2.15.* kornia==0.9.* lpips==0.1.4 torchvision safetensors pycolmap==4.2.1
	touch $@

# The documentation site: mdBook from crates.io, kept in the user's cache.
MDBOOK := $(CACHE)/mdbook/bin/mdbook
$(MDBOOK):
	cargo install mdbook --version 0.5.4 --locked --root $(CACHE)/mdbook

site: $(MDBOOK)  ## the documentation as a web site, in build/site
	$(MDBOOK) build docs
	@python3 tools/check_links.py build/site
	@echo "Open build/site/index.html"

tutorial-pictures: demo  ## the pictures of docs/tutorial.md from a run of the demo (needs Node.js and Chromium)
	@tools/setup.sh ffmpeg chromium
	tools/tutorial_pictures.sh $(SAT_RECON) out/demo
