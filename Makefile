# Every target first creates the environment in .venv, so `make demo` and `make test` work from a fresh clone.
SHELL := /bin/bash
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
export PIP_CONSTRAINT := constraints.txt
PACKAGES := model runtime data synthetic drawing rig evaluation weights training export jobs cli

# An editable install finds the packages by an import hook, which static tools cannot follow. These links can be followed.
define link_packages
	site=$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/duospacenet; mkdir -p "$$site"; \
	for part in $(PACKAGES) package/__init__.py package/py.typed; do ln -sfn "$(CURDIR)/$$part" "$$site/"; done
endef

# The demo needs PyTorch, which the clean environment borrows from .venv, and the weights: exit code 6 without either.
define check_demo
	cd out/wheel && venv/bin/duospacenet demo --out demo; test $$? = 6
	$(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
		> "$$(out/wheel/venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/pytorch.pth"
	cd out/wheel && venv/bin/duospacenet demo --out demo; test $$? = 6
	out/wheel/venv/bin/python -m pip install --quiet --no-deps out/wheel/dist/duospacenet_weights-*.whl
	cd out/wheel && venv/bin/duospacenet demo --out demo
endef

.PHONY: help demo schemas test docs wheel-check proof bench scores ablation-scores nano-ablations ablations large nuscenes nuscenes-scale batch serving consumers consumers-cpp consumers-browser browser reliability faults mutants soak fuzz speeds real lint format clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 17

.venv/.installed: pyproject.toml constraints.txt
	"$(PYTHON)" -m venv .venv
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	$(link_packages)
	touch $@

demo: .venv/.installed ## export, prove, run and evaluate the trained nano on a synthetic drive: see out/demo
	$(BIN)/python -m duospacenet.cli.main demo --out out/demo

schemas: .venv/.installed ## write the JSON Schemas in docs/schemas
	$(BIN)/python -c 'from duospacenet.jobs.json_schemas import write_schemas; write_schemas("docs/schemas")'

test: .venv/.installed ## run the test suite
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

docs: .venv/.installed ## build the documentation website in out/site; a broken link fails
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict --site-dir out/site

wheel-check: .venv/.installed ## build sdists and wheels, run a bundle and the demo from clean installs, print installed sizes
	rm -rf build weights_package/build out/wheel && mkdir -p out/wheel
	$(BIN)/python -m build --outdir out/wheel/dist .
	$(BIN)/python -m build --outdir out/wheel/dist weights_package
	"$(PYTHON)" -m venv out/wheel/venv
	out/wheel/venv/bin/python -m pip install --quiet out/wheel/dist/duospacenet-*.whl
	out/wheel/venv/bin/python benchmarks/installed_sizes.py
	$(BIN)/duospacenet export --preset tiny --random-weights --out out/wheel/bundle
	cd out/wheel && venv/bin/duospacenet --version && venv/bin/duospacenet run bundle synthetic:7:4 --out results --json
	$(check_demo)

proof: .venv/.installed ## parity and latency of tiny, nano and small, as in docs/results (10 minutes)
	$(BIN)/python -m benchmarks.proof_table out/proof tiny nano small --source synthetic:11:12

bench: .venv/.installed ## speed of nano and small, float32 and int8, beside alternatives: see out/bench (an hour)
	rm -rf out/bench && mkdir -p out/bench
	$(BIN)/duospacenet export --preset nano --weights weights/nano.safetensors --out out/bench/nano
	$(BIN)/duospacenet export --preset small --random-weights --out out/bench/small
	$(BIN)/duospacenet quantize out/bench/nano --out out/bench/nano-int8 \
		$(foreach seed,$(shell seq 200 207),--source synthetic:$(seed):16)
	$(BIN)/duospacenet quantize out/bench/small --out out/bench/small-int8 --no-metrics --source synthetic:200:16
	for bundle in nano small nano-int8 small-int8; do \
		$(BIN)/duospacenet bench out/bench/$$bundle $(BENCH) --against eager,stateless,openvino --json \
			--plot out/bench/$$bundle.png > out/bench/$$bundle.json || exit; \
	done

# Options of `make bench`, for example BENCH='--source ../my_rig --queries 100'.
BENCH ?=

# 16 held-out synthetic drives of 16 frames.
HELD_OUT := $(foreach seed,$(shell seq 100 115),synthetic:$(seed):16)

scores: .venv/.installed ## metrics of the trained nano, with the window and with single frames (5 minutes)
	rm -rf out/scores && mkdir -p out/scores
	$(BIN)/python -m duospacenet.cli.main export --preset nano --weights weights/nano.safetensors --out out/scores/bundle
	$(BIN)/python -m duospacenet.cli.main eval out/scores/bundle $(HELD_OUT) --plots out/scores/plots
	$(BIN)/python -m duospacenet.cli.main eval out/scores/bundle $(HELD_OUT) --single-frame

ablation-scores: .venv/.installed ## train and evaluate every row of the ablation tables (hours)
	$(BIN)/python -m benchmarks.ablation_scores out/ablation-scores

# The device of `make nano-ablations`, for example DEVICE=cuda.
DEVICE ?= cpu

nano-ablations: .venv/.installed ## train the trained nano on as rows of the ablation tables, two seeds each (three hours without a GPU)
	$(BIN)/python -m benchmarks.trained_ablations out/nano-ablations --render
	for seed in 0 1; do for row in full stacking attention no-fde; do \
		$(BIN)/python -m benchmarks.trained_ablations out/nano-ablations \
			--row $$row --seed $$seed --device $(DEVICE) || exit; \
	done; done

ablations: .venv/.installed ## parity of the paper's ablations at the sizes nano and small (an hour)
	$(BIN)/python -m benchmarks.proof_table out/ablations 'nano-*' 'small-*'

large: .venv/.installed ## parity of base and large, and both over the real frames in ../shared/data (an hour, 20 GB)
	$(BIN)/python -m examples.nuscenes_scene out/large/scene 2
	$(BIN)/python -m benchmarks.proof_table out/large base large --source out/large/scene

# A scene of `make nuscenes`, for pictures and recordings.
NUSCENES_SCENE := nuscenes:out/nuscenes/root/scene-0103

nuscenes: export DUOSPACENET_CACHE := $(CURDIR)/out/nuscenes/cache
nuscenes: .venv/.installed ## a synthetic nuScenes root: index, run nano, evaluate, submit, draw and record (10 minutes)
	rm -rf out/nuscenes && mkdir -p out/nuscenes
	$(BIN)/duospacenet synthetic out/nuscenes/root --scenes 10 --frames 16 --format nuscenes
	$(BIN)/duospacenet export --preset nano --weights weights/nano.safetensors --out out/nuscenes/bundle
	$(BIN)/duospacenet run out/nuscenes/bundle nuscenes:out/nuscenes/root --out out/nuscenes/results --maps \
		--format jsonl,nuscenes --submission-min-score 0.01
	$(BIN)/duospacenet eval out/nuscenes/bundle nuscenes:out/nuscenes/root --plots out/nuscenes/plots
	$(BIN)/duospacenet eval --results out/nuscenes/results/results_nusc.json nuscenes:out/nuscenes/root
	$(BIN)/duospacenet run out/nuscenes/bundle $(NUSCENES_SCENE) --out out/nuscenes/drawn --maps --heatmaps \
		--draw-ground-truth --video --recording out/nuscenes/drawn.mcap
	$(BIN)/duospacenet run out/nuscenes/bundle $(NUSCENES_SCENE) --out out/nuscenes/fast --maps --fast-decoding \
		--recording out/nuscenes/fast.rrd
	$(BIN)/duospacenet compare out/nuscenes/drawn out/nuscenes/fast $(NUSCENES_SCENE) --out out/nuscenes/compared \
		--frame 4 --frame 12 --ellipses

nuscenes-scale: .venv/.installed ## time and memory for trainval's 34,149 frames, and for a scene folder of 30,000 (8 minutes, 3 GB)
	$(BIN)/python -m benchmarks.nuscenes_scale out/nuscenes-scale
	$(BIN)/python -m benchmarks.scene_folder_scale out/nuscenes-scale

serving: .venv/.installed ## a real Triton without Docker: sequences of vehicles, and load with nano int8 (10 minutes)
	rm -rf out/serving && mkdir -p out/serving
	$(BIN)/python -m pytest tests/jobs/serving/test_triton_server.py
	$(BIN)/duospacenet export --preset nano --weights weights/nano.safetensors --out out/serving/nano
	$(BIN)/duospacenet quantize out/serving/nano --out out/serving/nano-int8 --no-metrics --source synthetic:200:16
	$(BIN)/python -m benchmarks.serving_load out/serving/nano-int8 out/serving/load

batch: export DUOSPACENET_CACHE := $(CURDIR)/out/batch/cache
batch: .venv/.installed ## batches with 1 to 4 workers and on Ray, with killed processes: equal results, and throughput (5 minutes)
	rm -rf out/batch && mkdir -p out/batch
	$(BIN)/duospacenet synthetic out/batch/root --scenes 4 --frames 10 --format nuscenes
	$(BIN)/duospacenet export --preset nano --weights weights/nano.safetensors --out out/batch/bundle
	$(BIN)/python -m benchmarks.batch_proof out/batch/bundle out/batch/proof nuscenes:out/batch/root

consumers: consumers-cpp consumers-browser ## build and test the programs that run a bundle without this toolkit

consumers-cpp: .venv/.installed ## build the C++ consumer, run its tests with sanitizers, and compare its boxes with Python's
	consumers/install_packages.sh
	cmake -S consumers/cpp -B out/cpp -G Ninja -D OpenVINO_DIR="$$($(BIN)/python -m tests.helpers.cpp_consumer)"
	cmake --build out/cpp
	$(BIN)/python -m pytest tests/consumers/test_cpp.py tests/consumers/test_cpp_golden.py

consumers-browser: .venv/.installed ## test the browser consumer in Node and in headless Chromium, and compare its boxes with Python's
	consumers/install_packages.sh
	cd consumers/browser && npm ci
	$(BIN)/python -m pytest tests/consumers/test_browser.py

browser: .venv/.installed ## build the browser page with nano in int8 and a synthetic drive: see consumers/browser/dist (10 minutes)
	rm -rf out/browser && mkdir -p out/browser
	$(BIN)/duospacenet export --preset nano --weights weights/nano.safetensors --out out/browser/nano
	$(BIN)/duospacenet quantize out/browser/nano --out out/browser/nano-int8 --no-metrics \
		$(foreach seed,$(shell seq 200 207),--source synthetic:$(seed):16)
	$(BIN)/duospacenet synthetic out/browser/drive --format scene-folder --frames 12 --seed 9 --width 800
	cd consumers/browser && npm ci && npm run demo -- ../../out/browser/nano-int8 ../../out/browser/drive && npm run build

reliability: .venv/.installed ## the reliability tests, with all rig mistakes, and runs killed at 30 random moments
	DUOSPACENET_MOMENTS=30 DUOSPACENET_ALL_MISTAKES=1 $(BIN)/python -m pytest tests/reliability

faults: .venv/.installed ## inject seeded faults and print which check finds which
	$(BIN)/python -m tests.faults.table
	$(BIN)/python -m tests.faults.structural_table

mutants: .venv/.installed ## test 150 random mutants of the runtime and of the parity proof, and print the survivors (an hour)
	$(BIN)/python -m benchmarks.mutants $${MUTANTS:-runtime export/parity} --count $${COUNT:-150} --seed $${SEED:-0}

soak: .venv/.installed ## 10,000 frames in four streams with every event: memory growth and sampled detections
	$(BIN)/python -m benchmarks.soak

speeds: .venv/.installed ## speed of the renderer, the evaluation and --help, as ratios
	$(BIN)/python -m benchmarks.rendering_speed
	$(BIN)/python -m benchmarks.evaluation_speed
	$(BIN)/python -m benchmarks.start_up_speed

fuzz: .venv/.installed ## damaged scenes, manifests, graphs, images and checkpoints, two minutes per kind
	FUZZ_SECONDS=$${FUZZ_SECONDS:-120} FUZZ_SEED=$${FUZZ_SEED:-$$RANDOM} $(BIN)/python -m pytest -s tests/fuzz

real: .venv/.installed ## run small on the real nuScenes frames in ../shared/data, and draw their ground truth
	rm -rf out/real
	$(BIN)/python -m examples.nuscenes_scene out/real/scene
	$(BIN)/python -m duospacenet.cli.main check-rig out/real/scene --out out/real/rig
	$(BIN)/python -m duospacenet.cli.main export --preset small --random-weights --out out/real/bundle
	$(BIN)/python -m duospacenet.cli.main run out/real/bundle out/real/scene --out out/real --draw-ground-truth --min-score 1

lint: .venv/.installed ## ruff, mypy and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p duospacenet
	$(BIN)/pyright

format: .venv/.installed ## apply ruff fixes and formatting
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove the environment and all outputs
	rm -rf .venv out build weights_package/build *.egg-info weights_package/*.egg-info .pytest_cache .ruff_cache .mypy_cache
