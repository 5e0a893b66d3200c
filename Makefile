# Every command that this repository needs. `make help` lists them.
# Only the release profile is used, so that the dependencies are built once for the demo, the tests and the product.

SHELL := /bin/bash
CARGO ?= cargo
PYTHON ?= python3
# Else a layer of Mesa calls a missing desktop session an error, on every start.
ifndef XDG_RUNTIME_DIR
export NODEVICE_SELECT := 1
endif

.DEFAULT_GOAL := help
.PHONY: help setup onnxruntime build test test-widths test-browser test-peers tidy check lint demo bench gpu-pack gpu-check

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 22

setup: ## Debian packages: COLMAP, a software Vulkan driver, pip (as root; else it says what to run)
	@tools/setup.sh

onnxruntime: ## the ONNX Runtime library, from its PyPI wheel, into .onnxruntime/
	@$(PYTHON) tools/fetch_onnxruntime.py

build: ## the program: target/release/fled
	$(CARGO) build --release --locked -p fled

test: setup onnxruntime ## every test
	$(PYTHON) -m unittest discover --start-directory tools
	$(CARGO) test --release --locked --workspace
	@$(MAKE) --no-print-directory test-widths

# Mesa's software driver takes its subgroups to be as wide as this, whatever the processor has.
test-widths: ## the kernels with subgroups of 4 and 16 instead of 8 invocations
	for bits in 128 512; do LP_NATIVE_VECTOR_WIDTH=$$bits $(CARGO) test --release --locked --quiet -p fled-core --lib -- \
	    splat:: noise:: shake::tests reconstruct::loss reconstruct::optimizer || exit 1; done

# FLED=PROGRAM tests that one and builds none; CHROMIUM=PROGRAM is used in place of Debian's.
test-browser: setup onnxruntime $(if $(FLED),,build) ## the dashboard in a real browser; needs Node 20 and npm
	@$(if $(CHROMIUM),,tools/setup.sh chromium)
	cd tests/browser && npm ci --loglevel=error && \
	    FLED=$(abspath $(or $(FLED),$(or $(CARGO_TARGET_DIR),target)/release/fled)) node --test *.test.js

# FLED=PROGRAM judges that one and builds none; TORCH=PYTHON has PyTorch already and saves its installation.
test-peers: setup onnxruntime $(if $(FLED),,build) ## scene.ply judged by software that is not ours; 5 GB under .peers/
	$(PYTHON) tools/peers.py $(if $(FLED),--fled $(FLED)) $(if $(TORCH),--python $(TORCH))

tidy: ## the rules of the house alone: fast, needs no GPU and no library
	$(CARGO) test --release --locked -p fled-tidy

check: ## types only, the fastest answer
	$(CARGO) check --release --locked --workspace --all-targets

lint: ## format and clippy, as strict as CI
	$(CARGO) fmt --all --check
	$(CARGO) clippy --release --locked --workspace --all-targets -- -D warnings

demo: setup onnxruntime build ## a dark capture, reconstructed by the service, with a before/after picture under demo/
	$(PYTHON) tools/demo.py

bench: build ## what training and rendering cost here, kernel by kernel; BENCH="--quick" and other arguments of fled bench
	$${CARGO_TARGET_DIR:-target}/release/fled bench $(BENCH)

gpu-pack: onnxruntime ## gpu-check/: all that a machine with a Vulkan driver and no Rust needs to be checked
	$(PYTHON) tools/gpu_pack.py

gpu-check: gpu-pack ## kernels, their cost and a whole job on this machine's adapter; GPU_CHECK="--quick" is short
	gpu-check/gpu_check.sh $(GPU_CHECK)
