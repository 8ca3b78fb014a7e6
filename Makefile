# make demo, make test, make accuracy, make soak, make fast, make check, make docs, make coverage, make lowest, make bench: each sets up what it needs first.
# Needs make and Python 3.11 or newer with venv (Debian: apt-get install make python3 python3-venv).

PYTHON ?= $(firstword $(shell for p in python3 python3.13 python3.12 python3.11 python3.14; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p; done; true))
BIN := .venv/bin
# A process has one thread; more only get in each other's way. A file stays with one process, which makes what its tests share
# once; golden sessions come first, each where there is room (tests/conftest.py). Tests of devices wait most of their time:
# three processes keep two cores busy.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
PROCESSES := $(shell expr 3 \* $$(getconf _NPROCESSORS_ONLN) / 2)

.PHONY: picture field-picture demo test accuracy soak fast coverage lowest chromium umockdev check types docs bench readme sony-raw clean

demo: .venv/installed
	$(BIN)/labkit demo

PYTEST := $(ONE_THREAD) $(BIN)/python -m pytest -n $(PROCESSES) --dist loadfile --no-loadscope-reorder

test: .venv/installed-test chromium umockdev
	$(PYTEST) -m 'not accuracy and not soak'

# Whole sessions against their truths. What passed with today's numerics (tests/accuracy.json) is not run again.
accuracy: .venv/installed-test
	$(PYTEST) -p tests.accuracy -m accuracy

soak: .venv/installed-test
	$(PYTEST) -m soak

# What says within a minute whether something is broken.
FAST := $(ONE_THREAD) BIN/python -m pytest -q -n auto --dist worksteal -m 'not slow' tests/unit
fast: .venv/installed-test
	$(subst BIN/,$(BIN)/,$(FAST))

# COVERAGE_OF: the tests that are counted.
COVERAGE_OF ?= tests
coverage: .venv/installed-test
	$(ONE_THREAD) $(BIN)/python -m pytest -q -n $(PROCESSES) --dist loadfile --no-loadscope-reorder --cov --cov-report=term --cov-report=html:build/coverage $(COVERAGE_OF)

# The oldest versions that pyproject.toml allows, installed and tried.
OLDEST := import tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	print(*(r.replace(">=", "==") for r in p["dependencies"] + p["optional-dependencies"]["test"]), sep="\n")
lowest: .venv-lowest/installed
	$(subst BIN/,.venv-lowest/bin/,$(FAST))

.venv-lowest/installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m venv --clear .venv-lowest
	$(BIN)/python -c '$(OLDEST)' > .venv-lowest/oldest.txt
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check -r .venv-lowest/oldest.txt
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	touch $@

# The display page is tested in a real browser; without one, those tests are skipped and say so.
chromium:
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || \
		{ apt-get -qq update && apt-get -qq install -y --no-install-recommends chromium; } >/dev/null 2>&1 || \
		echo "no Chromium, and apt-get cannot install it: the web pages will not be tested" >&2

# USB trouble is played to libgphoto2 by umockdev; without it, those tests are skipped and say so.
umockdev:
	@{ command -v umockdev-wrapper && \
		/usr/bin/python3 -c 'import gi; gi.require_version("UMockdev", "1.0"); from gi.repository import UMockdev'; } >/dev/null 2>&1 || \
		{ apt-get -qq update && apt-get -qq install -y --no-install-recommends umockdev gir1.2-umockdev-1.0 python3-gi libusb-1.0-0; } >/dev/null 2>&1 || \
		echo "no umockdev, and apt-get cannot install it: USB trouble will not be tested" >&2

check: types docs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest -q tests/unit/test_imports.py tests/unit/test_house.py tests/unit/test_readme.py

# The README's picture of a report, by Chromium.
picture: .venv/installed chromium
	rm -rf build/demo
	mkdir -p build
	$(ONE_THREAD) $(BIN)/labkit demo --out build/demo
	$$(command -v chromium || command -v chromium-browser || command -v google-chrome) --headless --no-sandbox --hide-scrollbars \
		--window-size=1280,1440 --screenshot=docs/report.png build/demo/results/latest/report.html

# The field guide's picture: the report of a simulated field, 2 × 3 carpets at two ranges.
field-picture: .venv/installed chromium
	rm -rf build/field build/field-session
	mkdir -p build
	$(ONE_THREAD) $(BIN)/python -m benchmarks.field_sessions build/field --ranges 1180 1260 --tile-px 144 --order 3
	$(BIN)/labkit import build/field/frames.csv build/field/plan.toml build/field-session
	$(ONE_THREAD) $(BIN)/labkit fit build/field-session
	$(ONE_THREAD) $(BIN)/labkit report build/field-session
	echo '<body style="margin:0"><iframe src="field-session/results/latest/report.html#field"' \
		'style="width:1200px;height:1400px;border:0"></iframe>' > build/field.html
	$$(command -v chromium || command -v chromium-browser || command -v google-chrome) --headless --no-sandbox --hide-scrollbars \
		--window-size=1200,1400 --screenshot=build/field.png build/field.html
	$(BIN)/python -c 'from PIL import Image; Image.open("build/field.png").convert("RGB").quantize(256, method=2).save("docs/field.png", optimize=True)'

types: .venv/installed-dev
	$(BIN)/mypy src/labkit tests $(wildcard benchmarks/*.py examples/*.py docs/*.py docs/generators/*.py)

# The documentation as a site in build/docs; what Sphinx warns of is an error, and so is a dead link.
docs: .venv/installed-dev
	$(BIN)/python -m sphinx -q -W --keep-going -b html -E docs build/docs
	$(BIN)/python -m docs.check_site build/docs

bench: .venv/installed-test
	$(BIN)/python -m benchmarks

# The tables of README.md and docs/accuracy.md, from benchmarks/claims.toml and the studies' results.
readme: .venv/installed-test
	$(BIN)/python -m benchmarks.claims

# A whole raw of a real mirrorless camera, out of another project's source archive: fetched, tested against, not kept here.
sony-raw: .venv/installed-test
	$(BIN)/python -m pip download --quiet --no-deps --no-binary :all: --dest build/sony libraw-cffi
	cd build/sony && tar -xzf libraw_cffi-*.tar.gz
	LABKIT_SONY_RAW=$$(find $(CURDIR)/build/sony -name '*.ARW') $(BIN)/python -m pytest -q tests/unit/test_raw.py -k mirrorless

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "needs Python 3.11 or newer with venv: apt-get install python3 python3-venv" >&2; exit 2; }
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

.venv/installed-test: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	touch $@ .venv/installed

.venv/installed-dev: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test,dev,docs]'
	touch $@ .venv/installed-test .venv/installed

clean:
	rm -rf .venv .venv-lowest build dist src/*.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage*
