# Everything sets up what it needs: a Debian-like machine with Python 3.11, a C compiler and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# A worker per core: further threads for its small matrices would only wait for each other. Bytecode
# is kept whatever the environment says, for the tests start the command often.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist worksteal

.PHONY: setup cross-tools ground-stations demo test test-long fast fuzz audit lint bench figures hidden-effects docs tutorial pictures tables clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,learn]'
	touch $@

cross-tools:  ## what runs FMUs of other platforms and looks at pages in the tests; without it these are skipped
	if [ "$$(id -u)" != 0 ]; then echo 'run as root: sudo make cross-tools' >&2; exit 1; fi
	apt-get update -qq
	apt-get install -y -qq --no-install-recommends qemu-user libc6-arm64-cross wine wine64 chromium

ground-stations: setup  ## MAVProxy, which hears the twin in a test; without its maps and graphs, half a GB
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --no-deps MAVProxy pyserial

demo: setup  ## find the effect hidden in built-in flights and write out/demo/report.html
	$(BIN)/uavtwin demo --out out/demo --force

test: setup lint  ## all but the longest tests
	$(PYTEST) -m 'not long'

test-long: setup  ## the longest tests, which hold at length what others hold in parts
	$(PYTEST) -m long

fast: setup  ## mathematics, properties, units: what takes a sixth of a second at most, without benchmarks
	$(PYTEST) -m 'not slow and not long' --ignore tests/benchmarks --ignore tests/fuzz

FUZZ := $(if $(COUNT),--count $(COUNT)) $(if $(MINUTES),--minutes $(MINUTES))
fuzz: setup  ## files changed at random: does one fell a reader, is a change told? MINUTES=10, or COUNT=1000
	PYTHONPATH=tests/rigs $(BIN)/python tests/fuzz/run.py $(FUZZ)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy

AUDIT_STAMP := $(VENV)/.audit-installed
$(AUDIT_STAMP): $(STAMP)
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --editable '.[audit]'
	touch $@

audit: $(AUDIT_STAMP)  ## known vulnerabilities of the pinned set, as PyPI's service knows them
	$(BIN)/pip-audit --strict --no-deps --disable-pip --progress-spinner off --requirement constraints.txt \
	  || { echo 'audit: not passed. After "could not be audited" or a failed connection nothing was judged: the service cannot be reached from here.' >&2; exit 1; }

bench: setup  ## the speed figures
	$(BIN)/python -m benchmarks.speed

figures: setup  ## the same, written into docs/results
	$(BIN)/python docs/_generate/figures.py --bench

DOCS_STAMP := $(VENV)/.docs-installed
$(DOCS_STAMP): $(STAMP)
	PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

docs: $(DOCS_STAMP)  ## the site, in site/; fails on any warning, such as a broken link
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

tables: setup  ## tables of the documents, from the definitions in code
	$(BIN)/python docs/_generate/tables.py

tutorial: setup  ## outputs and pictures of the tutorial; needs chromium
	$(BIN)/python docs/_generate/tutorial.py

pictures: setup  ## drawings, and the pictures of pages; needs chromium
	$(BIN)/python docs/_generate/drawings.py
	$(BIN)/python docs/_generate/pictures.py

SUBSET ?= 40
JOBS ?= 2
hidden-effects: setup  ## does explain name hidden effects? 10 minutes on two cores
	$(BIN)/python -m benchmarks.hidden_effects --subset $(SUBSET) --magnitude medium --jobs $(JOBS) --out out/hidden_effects

clean:
	rm -rf $(VENV) out site
