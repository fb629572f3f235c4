# Two commands do everything on a fresh machine: `make run` and `make test`.
# Each makes its own virtual environment; PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3

SOURCES := $(shell find src templates -type f -not -name '*.pyc')

.PHONY: run test docs lint golden clean

run: .venv-run/ready
	mkdir -p out
	.venv-run/bin/cotree run slider-pendulum --sensitivity L --plot out/slider-pendulum.png
	.venv-run/bin/cotree graph slider-pendulum -o out/slider-pendulum-graph.png
	@echo "pictures: out/slider-pendulum.png (figures 5 and 6), out/slider-pendulum-graph.png"

test: .venv-test/ready
	.venv-test/bin/python -m pytest

docs: .venv-docs/ready
	.venv-docs/bin/sphinx-build --fail-on-warning --keep-going --quiet docs out/docs
	.venv-docs/bin/python docs/check_links.py out/docs
	@echo "site: out/docs/index.html"

lint: .venv-test/ready
	.venv-test/bin/ruff check .
	.venv-test/bin/ruff format --check .
	.venv-test/bin/mypy
	.venv-test/bin/lint-imports
	.venv-test/bin/codespell src tests docs README.md CONTRIBUTING.md CHANGELOG.md

golden: .venv-test/ready
	.venv-test/bin/python -m pytest --update-golden tests

.venv-run/ready: pyproject.toml $(SOURCES)
	$(PYTHON) -m venv .venv-run
	.venv-run/bin/python -m pip install --quiet --disable-pip-version-check .
	touch $@

.venv-test/ready: pyproject.toml
	$(PYTHON) -m venv .venv-test
	.venv-test/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	touch $@

.venv-docs/ready: pyproject.toml $(SOURCES)
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check ".[docs]"
	touch $@

clean:
	rm -rf .venv-run .venv-test .venv-docs out dist docs/examples docs/reference
