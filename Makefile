# Everything from a fresh clone: `make test` installs what it needs, then lints, checks types and runs the tests.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: install serve demo test lint format types bench clean

install: $(READY)

$(READY): pyproject.toml constraints.txt static/package-lock.json
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "InterLoc needs Python 3.11 or newer; PYTHON=... chooses one")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[service,dask,dev]"
	@if command -v npm >/dev/null; then npm ci --silent --omit=dev --prefix static; \
	else echo "npm was not found: the web service will run without its page."; fi
	@touch $(READY)

# The web service and its page, for this machine only: drives and results in ./interloc-data.
serve: $(READY)
	$(BIN)/interloc serve

# A drive through a made-up town, found, mapped and scored against the town's own map: all in demo/.
demo: $(READY)
	$(BIN)/interloc simulate town --small -o demo/drive
	$(BIN)/interloc run demo/drive -o demo/result --osm demo/drive/map.osm
	@echo
	@echo "The report:                            demo/result/report.html"
	@echo "The map, for QGIS or any GIS:          demo/result/intersections.geojson"
	@echo "The steps of the method at one scan:   $(BIN)/interloc explain demo/drive --frame 100 -o demo/steps"

test: lint types
	$(BIN)/python -m pytest -n auto --cov --cov-report=term:skip-covered

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(READY)
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python tests/benchmarks/bench.py

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage
