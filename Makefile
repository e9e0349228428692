# Every target works on a machine that has only Python >= 3.11, pip and make.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes -r

.PHONY: run test coverage lint docs site table2 calibrate validate torture release bench clean

run: $(STAMP)            ## fly the main scenario: table, results/landing.h5 and its figures
	$(BIN)/navsim run scenarios/landing.yaml

# whatever starts Python keeps what it compiles: a start without that takes twice as long, and the tests have hundreds
export PYTHONDONTWRITEBYTECODE :=

# the tests of a file stay in one process, which makes what they share once; what fails is run again to show the values
# in its assertions: to prepare all assertions for that takes each process eight seconds
test: $(STAMP)           ## the whole test suite
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --assert=plain \
	  || { $(BIN)/python -m pytest --last-failed --last-failed-no-failures none; false; }

coverage: $(VENV)/.coverage ## the test suite, and the lines of each file that it ran, in processes that it started too
	$(BIN)/python -m coverage erase
	$(BIN)/python -m coverage run -m pytest -n 2 --dist loadfile --no-loadscope-reorder
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

docs: $(STAMP)           ## the names of keys from the schemas, docs/validation.md from the oracle tests
	$(BIN)/python scripts/key_names.py
	$(BIN)/python -m pytest -n 2 tests/oracle --validation docs/validation.md

site: $(STAMP)           ## the pages of docs/, and of the reference from the schemas, as a site: docs/_build/html/index.html; a warning is an error
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs docs/_build/html

table2: $(STAMP)         ## the paper's Table 2 beside the computed one: results/table2.*
	$(BIN)/navsim table2

calibrate: $(STAMP)      ## find the skies of Table 2 again: scenarios/table2*.yaml
	$(BIN)/python scripts/calibrate_table2.py

validate: $(STAMP)       ## the long statistical studies: tables in docs/; every documented command in full
	$(BIN)/python scripts/covariance_against_runs.py
	$(BIN)/python scripts/covariance_matrix.py
	$(BIN)/python scripts/near_passes.py
	$(BIN)/python scripts/filter_consistency.py --runs 200
	$(BIN)/python scripts/mixture_tails.py
	$(BIN)/python scripts/outages.py
	$(BIN)/python scripts/lasting_errors.py
	$(BIN)/python scripts/sensor_errors.py
	$(BIN)/python scripts/heights.py
	$(BIN)/python scripts/wrong_fix.py
	$(BIN)/python scripts/landing_aids.py
	$(BIN)/python scripts/faults.py
	$(BIN)/python scripts/integrity.py
	$(BIN)/python scripts/interference.py
	$(BIN)/python scripts/filter_settings.py
	$(BIN)/python scripts/replays.py
	$(BIN)/python scripts/replay_checks.py
	$(BIN)/python scripts/rare_events.py
	$(BIN)/python scripts/rare_totals.py
	$(BIN)/python scripts/control_variates.py
	$(BIN)/python scripts/recorded_approach.py
	$(BIN)/python -m pytest -n 2 --long
	$(BIN)/python -m pytest tests/product/test_documented_commands.py tests/product/test_console_blocks.py tests/product/test_notebooks.py --as-written

torture: $(STAMP)        ## mutants, kills, full disks, damaged files with ten fresh seeds, for hours: docs/reliability.md
	$(BIN)/python -m tests.torture

lint: $(STAMP)           ## style, types, and the prose of pages, help and messages
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python scripts/prose.py

release: $(STAMP)        ## sdist and wheel in dist/, tried under every Python at hand: docs/packaging-measured.md; needs the package index
	$(BIN)/python scripts/release.py

bench: $(VENV)/.bench    ## speed as ratios within one run: rivals, the version before, C, sizes; 20 minutes; benchmarks/RESULTS.md
	$(BIN)/python benchmarks/run.py

# most modules are never imported, the others compiled when they are; the lock names all that is needed; uv installs it
# in a quarter of pip's time, pip in two halves at once where uv can't (it does not know the indexes of pip's settings)
$(STAMP): pyproject.toml requirements.lock requirements-uv.lock
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "navsim needs Python 3.11 or newer, this is " + sys.version)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) requirements-uv.lock && $(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --require-hashes -r requirements.lock || { \
	  for half in 0 1; do awk -v half=$$half '/^[^ ]/ { n++ } n % 2 == half' requirements.lock >$(VENV)/$$half.lock; done; \
	  $(PIP) $(VENV)/0.lock & first=$$!; $(PIP) $(VENV)/1.lock && wait $$first; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

$(VENV)/.coverage: $(STAMP) requirements-coverage.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-coverage.lock
	touch $@

$(VENV)/.bench: $(STAMP) requirements-bench.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-bench.lock
	touch $@

clean:                   ## remove the environment and everything generated
	rm -rf $(VENV) docs/_build docs/reference .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist results/*.h5 results/landing* results/table2* results/torture results/bench
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
