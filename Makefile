# `make demo` and `make test` work from a fresh checkout; both make the environment first.
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

.PHONY: help demo test proof scores ablation-scores ablations large reliability faults soak fuzz real lint format clean

help: ## what there is
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 17

.venv/.installed: pyproject.toml constraints.txt
	"$(PYTHON)" -m venv .venv
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	$(link_packages)
	touch $@

demo: .venv/.installed ## the main job, end to end, with the trained weights, on a drawn drive
	$(BIN)/python -m duospacenet.cli.main demo --out out/demo

test: .venv/.installed ## the whole suite
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

proof: .venv/.installed ## parity and latency of tiny, nano and small: the README's tables (minutes)
	$(BIN)/python -m benchmarks.proof_table out/proof tiny nano small --source synthetic:11:12

# 16 frames each of 16 drives that no training sees.
HELD_OUT := $(foreach seed,$(shell seq 100 115),synthetic:$(seed):16)

scores: .venv/.installed ## the README's numbers of the trained weights: with the window, and of single frames (minutes)
	rm -rf out/scores && mkdir -p out/scores
	$(BIN)/python -m duospacenet.cli.main export --preset nano --weights weights/nano.safetensors --out out/scores/bundle
	$(BIN)/python -m duospacenet.cli.main eval out/scores/bundle $(HELD_OUT) --plots out/scores/plots
	$(BIN)/python -m duospacenet.cli.main eval out/scores/bundle $(HELD_OUT) --single-frame

ablation-scores: .venv/.installed ## every row of the ablation tables trained alike on small drawn drives, and judged (hours)
	$(BIN)/python -m benchmarks.ablation_scores out/ablation-scores

ablations: .venv/.installed ## parity of the paper's ablations, at the sizes nano and small (an hour)
	$(BIN)/python -m benchmarks.proof_table out/ablations 'nano-*' 'small-*'

large: .venv/.installed ## parity of base and large, and both over the real frames in ../shared/data, played twice (an hour, 20 GB)
	$(BIN)/python -m examples.nuscenes_scene out/large/scene 2
	$(BIN)/python -m benchmarks.proof_table out/large base large --source out/large/scene

reliability: .venv/.installed ## the rows of the reliability list; runs are killed at 30 random moments by each signal
	DUOSPACENET_MOMENTS=30 $(BIN)/python -m pytest tests/reliability

faults: .venv/.installed ## which check catches which of the seeded faults, as a table
	$(BIN)/python -m tests.faults.table

soak: .venv/.installed ## 10,000 frames in four streams with everything that goes wrong: memory, and answers compared
	$(BIN)/python -m benchmarks.soak

fuzz: .venv/.installed ## damaged scenes, manifests, graphs, images and checkpoints, two minutes a kind of file
	FUZZ_SECONDS=$${FUZZ_SECONDS:-120} FUZZ_SEED=$${FUZZ_SEED:-$$RANDOM} $(BIN)/python -m pytest -s tests/fuzz

real: .venv/.installed ## `small` on the real nuScenes frames in ../shared/data, with their true boxes
	rm -rf out/real
	$(BIN)/python -m examples.nuscenes_scene out/real/scene
	$(BIN)/python -m duospacenet.cli.main check-rig out/real/scene --out out/real/rig
	$(BIN)/python -m duospacenet.cli.main export --preset small --random-weights --out out/real/bundle
	$(BIN)/python -m duospacenet.cli.main run out/real/bundle out/real/scene --out out/real --draw-truth --min-score 1

lint: .venv/.installed ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p duospacenet
	$(BIN)/pyright

format: .venv/.installed ## ruff's fixes and layout
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove the environment and what was written
	rm -rf .venv out build *.egg-info .pytest_cache .ruff_cache .mypy_cache
