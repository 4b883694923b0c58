# Everything from a fresh clone: `make test` installs what it needs, then lints, checks types and runs the tests.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PORT ?= $(or $(INTERLOC_PORT),8000)
SERVE ?= yes
# Tests of real kills, servers and browsers can fail on a machine that is busy. A test that fails is run once more, and
# is named at the end of the run as one that needed it.
AGAIN := --reruns 1
READY := $(VENV)/.ready
READY_TO_TEST := $(VENV)/.ready-to-test
COMPILED := $(VENV)/.compiled
# Versions to install; `.ci/oldest` prints the oldest that are allowed.
CONSTRAINTS ?= constraints.txt
PIP_INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --progress-bar off -c $(CONSTRAINTS)
# Processes that have done their part help the others; bytecode is kept, for the processes that the tests start.
PYTEST := -m pytest -n auto --dist worksteal
RUN := PYTHONDONTWRITEBYTECODE= $(BIN)/python
BIOME := static/node_modules/.bin/biome
BUNDLE := static/bundle/main.js

.PHONY: install serve demo page-tools test coverage test-quick lint format types bench load torture hostile bench-page screenshots image clean

install: $(READY) $(BUNDLE)

$(READY): pyproject.toml $(CONSTRAINTS) static/package-lock.json
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "InterLoc needs Python 3.11 or newer; PYTHON=... chooses one")'
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "Python has no venv; on Debian and Ubuntu: apt install python3-venv"; exit 1; }
	@command -v npm >/dev/null || echo "npm was not found: everything but the page of the web service will work; on Debian and Ubuntu: apt install npm"
	@echo "Installing InterLoc into $(VENV), once: two to three minutes, much of it without a word."
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) -e ".[service,label,live,ros,las,odometry,storage]"
	@if command -v npm >/dev/null; then npm ci --silent --omit=dev --prefix static; fi
	@echo "Compiling the kernels of the method, once: 20 seconds on a free core, up to two minutes on a busy machine."
	$(BIN)/python -c "from app.work.kinds import compile_kernels; compile_kernels()"
	@touch $(READY)

# The page in a few small files; without them, or when they are older than the modules, those are served as they are.
$(BUNDLE): $(READY) static/package.json $(wildcard static/js/*.js static/js/*/*.js static/css/*.css)
	@if command -v npm >/dev/null; then npm run --silent build --prefix static \
	|| echo "The page could not be bundled: its modules are served as they are."; fi

# What linters, types and tests need besides; what they import of it is compiled then.
$(READY_TO_TEST): $(READY)
	$(PIP_INSTALL) --no-compile -e ".[service,dask,label,live,ros,ros2,las,odometry,parquet,storage,dev]"
	@touch $(READY_TO_TEST)

# The web service and its page, for this machine only: drives and results in ./interloc-data. `make serve PORT=8001` has
# it elsewhere.
serve: $(READY) $(BUNDLE)
	$(BIN)/interloc serve --port $(PORT)

# A drive through a made-up town, made once. Its folder appears when it is complete; another version of the simulator or
# of the command makes it anew.
demo/drive/simulation.json: $(READY) Makefile $(wildcard interloc/lab/*.py interloc/lab/*.osm )
	$(BIN)/interloc simulate town --part quarter --ground-only --columns 720 -o demo/drive

# The drive mapped and scored against the town's own map, all in demo/; then the same in the web service, until Ctrl-C.
# `make demo SERVE=` leaves the service out, `make demo PORT=8001` has it elsewhere.
demo: demo/drive/simulation.json $(BUNDLE)
	$(BIN)/interloc run demo/drive -o demo/drive_result --osm demo/drive/map.osm
	@echo
	@echo "The report:                            demo/drive_result/report.html"
	@echo "The map, for QGIS or any GIS:          demo/drive_result/intersections.geojson"
	@echo "The steps of the method at one scan:   $(BIN)/interloc explain demo/drive --frame 613 -o demo/steps"
ifneq ($(SERVE),)
	@echo
	@trap : INT; { \
	  until $(BIN)/python -c "from urllib.request import urlopen as ask; ask('http://127.0.0.1:$(PORT)/readyz')" 2>/dev/null; \
	  do sleep 0.5; done; \
	  exec $(BIN)/interloc push demo/drive --osm demo/drive/map.osm --run --server http://127.0.0.1:$(PORT); \
	} & $(BIN)/interloc serve --port $(PORT) --data-dir demo/service --log-level error; kill $$! 2>/dev/null || true
endif

test: page-tools $(BUNDLE)
	@$(MAKE) --no-print-directory -j 2 lint types $(COMPILED)
	$(RUN) $(COVER) $(PYTEST) $(AGAIN)

# The same, and notes in coverage.txt which lines were not run; takes half as long again.
coverage: COVER := -m slipcover
coverage: test
	@awk 'END {print "coverage: " $$NF " % of the lines; the others: coverage.txt"}' coverage.txt

# What needs neither a server nor a browser: about a minute.
test-quick: $(READY_TO_TEST)
	$(RUN) $(PYTEST) -n logical $(addprefix --ignore=tests/,app chain cli client lab page performance test_demo.py)

# The kernels are compiled once, and not by all processes of the tests at the same time.
$(COMPILED): $(READY_TO_TEST) $(shell grep -rlE "(import|def) compiled" interloc --include=*.py)
	$(BIN)/python -m tests.forks
	@touch $(COMPILED)

# Linter, types and tests of the page, where npm is there to install them.
page-tools: $(READY_TO_TEST)
	@if command -v npm >/dev/null && [ ! -x $(BIOME) ]; then npm ci --silent --prefix static; fi

lint: $(READY_TO_TEST)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo
	@if [ -x $(BIOME) ]; then npm run --silent lint --prefix static; \
	else echo "skipped: linter and types of the page are not installed (npm ci in static/)"; fi

format: $(READY_TO_TEST)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	@if [ -x $(BIOME) ]; then npm run --silent format --prefix static; \
	else echo "skipped: the formatter of the page is not installed (npm ci in static/)"; fi

types: $(READY_TO_TEST)
	$(BIN)/mypy

bench: $(READY_TO_TEST)
	$(BIN)/python -m tests.performance.bench

# What the service carries: uploads, reads, listeners, memory; needs 10 GB of disk and some minutes.
load: $(READY_TO_TEST)
	$(BIN)/python -m tests.performance.load

# What the service survives: kills at random moments, lost databases, backups under load; takes more than an hour.
torture: $(READY_TO_TEST)
	$(BIN)/python -m tests.performance.torture

# A short job of one client next to ten hostile ones of another; needs 2 GB of disk and some minutes.
hostile: $(READY_TO_TEST)
	$(BIN)/python -m tests.performance.hostile

# How smoothly the map moves with ten thousand detections; needs Chromium.
bench-page: $(READY_TO_TEST)
	$(BIN)/python -m tests.performance.page

# The pictures of the page in the README; needs Chromium.
screenshots: $(READY_TO_TEST)
	$(BIN)/python -m docs.screenshots

# The image, by docker, podman or buildah, whichever is there; tests/test_image.py starts it where it was built.
CONTAINER ?= $(or $(shell command -v docker),$(shell command -v podman),$(shell command -v buildah))
image:
	@[ -n "$(CONTAINER)" ] || { echo "docker, podman or buildah builds the image; none was found"; exit 1; }
	BUILDAH_FORMAT=docker $(CONTAINER) build $(BUILD_OPTIONS) -t interloc .

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis coverage.txt
