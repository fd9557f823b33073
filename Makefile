PYTHON ?= python3.11
VENV ?= .venv

PIP := $(VENV)/bin/python -m pip --disable-pip-version-check
STAMP := $(VENV)/.valvesim-installed
AUDIT := .venv-audit
LOCKED = $(shell sed -n 's/^\([A-Za-z0-9._-]*\)==.*/\1/p' requirements.lock)

# Neighbours in a file stay on one worker, which has compiled their models and made what they share.
PYTEST := $(VENV)/bin/python -m pytest -q -n auto --dist worksteal

.PHONY: launch test test-all test-browser docs coverage lint lock audit sbom licences clean

launch: $(STAMP)
	$(VENV)/bin/valvesim run scenarios/launch_shock.toml -o results/launch_shock

# The quick tests; what they leave out: docs/tests.md.
test: $(STAMP)
	$(PYTEST)

# The slow ones too: more cases of the same, and whole diagnoses.
test-all: $(STAMP)
	$(PYTEST) -m ""

# The interactive pages in a real browser: Debian's Chromium, or the one that CHROMIUM names.
test-browser: $(STAMP)
	@command -v "$${CHROMIUM:-chromium}" >/dev/null || \
		{ echo "error: no Chromium: sudo apt-get install chromium, or make test-browser CHROMIUM=/path/to/it" >&2; exit 1; }
	@$(PIP) install -qq playwright axe-playwright-python
	VALVESIM_BROWSER=required $(VENV)/bin/python -m pytest -q -m "" tests/browser

# The documentation as a site in site/, without a network; its gallery runs a handful of commands.
docs: $(STAMP)
	@$(PIP) install -qq -e '.[docs]' --no-build-isolation
	$(VENV)/bin/python -m mkdocs build --quiet
	@echo "valvesim: open site/site/index.html"

# By branch, of the quick tests.
coverage: $(STAMP)
	$(PYTEST) --cov=valvesim --cov-branch --cov-report=term-missing:skip-covered

lint: $(STAMP)
	$(VENV)/bin/python -m ruff check .
	$(VENV)/bin/python -m mypy
	$(VENV)/bin/lint-imports --no-cache

# Keeps the pins that still fit; `rm requirements.lock` first to move them all.
lock: | $(VENV)/bin/pip-compile
	@echo "valvesim: locking pyproject.toml into requirements.lock"
	@CUSTOM_COMPILE_COMMAND="make lock" $(VENV)/bin/pip-compile --quiet --extra test,dev,fleet \
		--build-deps-for editable --generate-hashes --allow-unsafe --strip-extras \
		--no-emit-index-url --no-emit-trusted-host --no-emit-find-links \
		--output-file requirements.lock pyproject.toml
	@sed -i '/^ *#.*http/Id' requirements.lock
	@! grep -i http requirements.lock || { echo "error: requirements.lock names a host, see the lines above" >&2; exit 1; }

# Known weaknesses of the locked packages. Needs the network: a package that the service does not know fails it too.
audit: sbom | $(AUDIT)/bin/pip-audit
	$(AUDIT)/bin/pip-audit --strict --disable-pip --require-hashes --progress-spinner off -r requirements.lock

# The software bill of materials (CycloneDX) of what the lock has installed, to go with a release.
sbom: $(STAMP) | $(AUDIT)/bin/pip-audit
	@mkdir -p dist
	$(AUDIT)/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible -o dist/valvesim.cdx.json \
		$(VENV)/bin/python

# The licences of the locked packages, as their metadata have them.
licences: $(STAMP) | $(AUDIT)/bin/pip-audit
	@sed '/^| Name/,$$d' docs/licences.md > docs/licences.md.new
	@$(AUDIT)/bin/pip-licenses --python=$(VENV)/bin/python --packages $(LOCKED) --from=mixed --format=markdown \
		>> docs/licences.md.new
	@mv docs/licences.md.new docs/licences.md

# A venv of its own, so that what looks is not part of what is looked at.
$(AUDIT)/bin/pip-audit: | $(VENV)/bin/python
	@echo "valvesim: installing pip-audit, cyclonedx-bom and pip-licenses into $(AUDIT)"
	@$(VENV)/bin/python -m venv $(AUDIT)
	@$(AUDIT)/bin/python -m pip --disable-pip-version-check install -qq pip-audit cyclonedx-bom pip-licenses

# Leaves the venv and results/ alone.
clean:
	rm -rf build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
	find valvesim tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# The lock holds all that is needed: nothing is resolved, so that no newer release can stand in its way.
$(STAMP): requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "valvesim: installing the locked packages and valvesim into $(VENV) (a minute or so)"
	@$(PIP) install -qq --require-hashes --no-deps -r requirements.lock
	@$(PIP) install -qq --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "error: '$(PYTHON)' is missing or older than Python 3.11: install it, or name another with make PYTHON=..." >&2; exit 1; }
	@echo "valvesim: making the venv $(VENV) with $(PYTHON)"
	@$(PYTHON) -m venv $(VENV)

# Only for a venv that has no pip-tools yet, so that `make lock` never needs a good lock.
$(VENV)/bin/pip-compile: | $(VENV)/bin/python
	@echo "valvesim: installing pip-tools into $(VENV)"
	@$(PIP) install -qq pip-tools
