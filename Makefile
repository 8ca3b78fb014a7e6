# make demo, make test, make check, make bench: each sets up what it needs first.
# Needs make and Python 3.11 or newer with venv (Debian: apt-get install make python3 python3-venv).

PYTHON ?= $(firstword $(shell for p in python3 python3.13 python3.12 python3.11 python3.14; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p; done; true))
BIN := .venv/bin
# Tests run one process a core; more threads than that only get in each other's way.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

.PHONY: demo test chromium check types bench sony-raw clean

demo: .venv/installed
	$(BIN)/labkit demo

# Tests of USB trouble want Debian's umockdev, gir1.2-umockdev-1.0, python3-gi and libusb-1.0-0; without them they are skipped.
test: .venv/installed-test chromium
	$(ONE_THREAD) $(BIN)/python -m pytest -n auto --dist worksteal

# The display page is tested in a real browser; without one, those tests are skipped and say so.
chromium:
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || \
		{ apt-get -qq update && apt-get -qq install -y --no-install-recommends chromium; } >/dev/null 2>&1 || \
		echo "no Chromium, and apt-get cannot install it: the web pages will not be tested" >&2

check: types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest -q tests/unit/test_imports.py

# mypy sees the packages where they will be installed, through links: drivers/ is labkit/drivers there.
types: .venv/installed-dev
	rm -rf build/typing && mkdir -p build/typing/labkit
	ln -s $(CURDIR)/labkit/* $(CURDIR)/drivers $(CURDIR)/targets build/typing/labkit/
	ln -s $(CURDIR)/tests $(CURDIR)/benchmarks $(CURDIR)/examples build/typing/
	cd build/typing && $(CURDIR)/$(BIN)/mypy --config-file $(CURDIR)/pyproject.toml \
		--cache-dir $(CURDIR)/.mypy_cache labkit tests $(wildcard benchmarks/*.py examples/*.py)

bench: .venv/installed-test
	$(BIN)/python -m benchmarks

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
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test,dev]'
	touch $@ .venv/installed-test .venv/installed

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
