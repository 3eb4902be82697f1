# Each target creates .venv by itself; the machine's own Python is left alone.
PYTHON ?= python3
BIN := .venv/bin
OUT ?= demo-report
# A worker a core, a thread each.
TESTS := OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses auto --dist worksteal
CONCEALED = concealed/dev $(if $(TORCHRBD_DATA),concealed/real)

.PHONY: demo test pytest lint types docs slow golden check concealed-dev clean

demo: .venv/base
	$(BIN)/torchrbd demo -o $(OUT)

# The notebooks of the docs use one core at a time: the tests fill the others.
test: .venv/dev
	$(MAKE) --jobs 4 lint types docs pytest

pytest: .venv/test
	$(TESTS)

slow: .venv/test
	$(TESTS) -m slow

# Diagnoses of fixed cases say what they said before: tests/golden.
golden: .venv/test
	$(TESTS) tests/golden -m ''

check: lint types
	$(BIN)/python -m pytest tests/test_architecture.py

lint: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/dev
	$(BIN)/pyright

docs: .venv/docs
	OMP_NUM_THREADS=1 NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

.venv/python:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	touch $@

.venv/base: .venv/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

.venv/test: .venv/base
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test,examples]'
	touch $@

.venv/benchmark: .venv/test
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[benchmark]'
	touch $@

.venv/docs: .venv/base
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $@

.venv/dev: .venv/test .venv/docs
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

concealed-dev: .venv/benchmark
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.concealed generate --set development --count 3 --seed 0 --workers 2 -o concealed/dev
	if [ -n "$$TORCHRBD_DATA" ]; then OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.concealed.real --count 1 --seed 0 -o concealed/real; fi
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.concealed.run diagnose $(CONCEALED) -o concealed/out -j 2
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.concealed.run rivals concealed/dev -o concealed/out -j 2
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.concealed.run oracle concealed/dev -o concealed/out -j 2
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.concealed.run score $(CONCEALED) -o concealed/out

clean:
	rm -rf .venv demo-report concealed site
