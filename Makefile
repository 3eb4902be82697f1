# Each target creates .venv by itself; the machine's own Python is left alone.
PYTHON ?= python3
BIN := .venv/bin
OUT ?= demo-report

.PHONY: demo test slow check clean

demo: .venv/base
	$(BIN)/torchrbd demo -o $(OUT)

test: .venv/test
	$(BIN)/python -m pytest

slow: .venv/test
	$(BIN)/python -m pytest -m slow

check: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/python -m pytest tests/test_architecture.py

.venv/python:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	touch $@

.venv/base: .venv/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

.venv/test: .venv/base
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	touch $@

.venv/dev: .venv/test
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

clean:
	rm -rf .venv demo-report
