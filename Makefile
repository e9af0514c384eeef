# make test     lint, types, layers and all tests, in a virtual environment made on first use
# make check    the same without the tests
# make test-full  make test with every combination in place of a spread of them; see tests/matrix.py
# make golden   run 80 commands, and compare all that they write with what the base commit wrote
#               (2 to 4 minutes); OPTIONS='--pixels' or '--threads 5'; see tests/golden/golden.py
# make faults   kill runs, fill disks and spoil inputs, thousands of times (about 80 minutes; the
#               spoilt inputs go on where they stopped); OPTIONS='--hypothesis 1000' for fewer
# make planted  plant 20 defects one by one; fails where the tests miss one (10 to 20 minutes);
#               DEFECTS='rounding' for some
# make bench    quality beside other interpolators, and run times beside OpenCV, the codecs and
#               others, with their goals; BENCHES='kernels policy' for some
# make bench-check  the same run times; fails where one misses its goal by more than a fifth
# make profile  where the time of upsample goes, as a table in tests/bench/PROFILE.md (10 minutes)
# make demo     upsample the example, score it against its ground truth, make a video
# make scenes   render the benchmark scenes and the training shots with Blender's module (hours;
#               goes on where it stopped); SCENES='lab town' for some, OPTIONS='--resolution 480p'
# make things   take shapes and textures for training shots out of Debian's packages (330 MB)
# make train    train all networks and policies by models/recipe.toml (many hours; goes on where it
#               stopped); DATA=folder of rendered scenes, STAGES='lookahead' for some
# make policy   train the policies from the tables under models/ (10 minutes); OPTIONS='--seed 1'
# make hardware simulate the predictor's Verilog on 2,000 states and synthesise it, in 15 minutes;
#               wants Icarus Verilog, Verilator and Yosys, and writes docs/hardware.md
# make docs     build the documentation as a site in build/site, and check its links
# make judge    score every method, with the network of MODEL=file, on the benchmark scenes
# make paper    every table and figure of the paper on the benchmark scenes, as build/bench/bench.md
#               and report.html beside it; goes on where it stopped; OPTIONS='--every 4'
# make clean    remove all that make made

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# The first folder under examples/ that holds rendered key frames.
EXAMPLE ?= $(firstword $(patsubst examples/%/keys,%,$(wildcard examples/*/keys)))
METHOD ?= exwarp
DEMO := build/demo

# Blender's module wants Python 3.11 and an environment of its own.
BLENDER ?= .blender
BLENDER_PYTHON ?= python3.11
SCENES ?= slum town lab tropical village arena courtyard variety
OPTIONS ?=
STAGES ?=
BENCHES ?=
DEFECTS ?=
DATA ?= $(HOME)/.cache/exwarp/scenes
TRAINING ?= $(HOME)/.cache/exwarp/training
POLICY ?= build/policy
MODEL ?= models/extrapolator.onnx

# Tests start hundreds of processes: what the first compiles of its imports, the others only read.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: test test-full check golden faults planted hardware bench bench-check profile demo scenes things blender train policy judge paper docs clean

test: check
	$(BIN)/pytest --all --numprocesses auto --dist worksteal

test-full: check
	EXWARP_TESTS=full $(BIN)/pytest --all --numprocesses auto --dist worksteal

check: $(STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

golden: $(STAMP)
	$(BIN)/python -m tests.golden.golden check $(OPTIONS)

faults: $(STAMP)
	$(BIN)/pip install --group faults
	EXWARP_TESTS=full $(BIN)/pytest --numprocesses auto --dist worksteal tests/faults
	$(BIN)/python -m tests.faults.fuzz $(OPTIONS)

planted: $(STAMP)
	$(BIN)/python -m tests.faults.planted $(DEFECTS)

bench: $(STAMP)
	$(BIN)/python -m tests.bench.quality
	$(BIN)/python -m tests.bench $(BENCHES)

hardware: $(STAMP)
	$(BIN)/python -m tests.hardware.measure $(OPTIONS)

bench-check: $(STAMP)
	$(BIN)/python -m tests.bench $(BENCHES) --check

profile: $(STAMP)
	$(BIN)/python -m tests.bench.profile_command $(OPTIONS)

demo: $(STAMP)
	@test -n "$(EXAMPLE)" || { echo "make: no examples/*/keys folder; see examples/" >&2; exit 1; }
	$(BIN)/exwarp upsample examples/$(EXAMPLE)/keys -o $(DEMO)/frames --method $(METHOD) \
	    --ground-truth examples/$(EXAMPLE)/truth --report $(DEMO)/report \
	    --video $(DEMO)/$(EXAMPLE).mp4 --overwrite
	@echo
	@echo "frames  $(DEMO)/frames"
	@echo "report  $(DEMO)/report/report.html"
	@echo "video   $(DEMO)/$(EXAMPLE).mp4"

train: $(STAMP)
	$(BIN)/python models/train.py --data $(DATA) -o $(TRAINING) $(STAGES)

policy: $(STAMP)
	$(BIN)/exwarp train policy -o $(POLICY) $(OPTIONS)
	$(BIN)/exwarp train tile-policy -o $(POLICY) $(OPTIONS)
	$(BIN)/exwarp train look-ahead-policy -o $(POLICY) $(OPTIONS)

judge: $(STAMP)
	$(BIN)/python -m tests.bench.paths --data $(DATA) --model $(MODEL) --out build/judge $(OPTIONS)

paper: $(STAMP)
	$(BIN)/exwarp bench $(DATA) -o build/bench $(OPTIONS)

docs: $(STAMP)
	$(BIN)/pip install --quiet --group docs
	$(BIN)/python docs/settings_page.py
	$(BIN)/mkdocs build --quiet --strict
	@echo "site  build/site/index.html"

blender: $(BLENDER)/.installed

scenes: $(BLENDER)/.installed
	@for scene in $(SCENES); do \
	    $(BLENDER)/bin/python examples/scenes/$$scene.py $(OPTIONS) || exit 1; \
	done

things: $(STAMP)
	$(BIN)/python examples/scenes/things.py $(OPTIONS)

$(BLENDER)/.installed:
	@$(BLENDER_PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
	    { echo "make: $(BLENDER_PYTHON) is missing or not 3.11; name another, as in make BLENDER_PYTHON=/path/python3.11" >&2; exit 1; }
	test -x $(BLENDER)/bin/pip || $(BLENDER_PYTHON) -m venv $(BLENDER)
	$(BLENDER)/bin/python -m pip install --quiet bpy==5.0.1 OpenEXR
	@touch $@

clean:
	rm -rf $(VENV) $(BLENDER) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks .import_linter_cache
	find exwarp_cli tests examples -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "make: $(PYTHON) is missing or older than 3.11; name another, as in make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	    { echo "make: $(PYTHON) cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	@# Modules are compiled when they are imported; most of what is installed never is.
	$(BIN)/python -m pip install --quiet --no-compile --editable . --group test
	@touch $@
