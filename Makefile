# Two commands do all the set-up: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
# mypy and import-linter do not see through an editable install's name mapping: they are shown
# the same files under the names they are imported by.
TREE := rm -rf $(VENV)/tree && mkdir -p $(VENV)/tree/tokt && \
	ln -s $(CURDIR)/tokt/* $(VENV)/tree/tokt/ && \
	for part in features labels training models inference; do \
	ln -s $(CURDIR)/$$part $(VENV)/tree/tokt/$$part; done

.PHONY: demo test check format clean

demo: $(READY)
	$(BIN)/tokt demo --out demo-out

test: $(READY)
	$(BIN)/python -m pytest -q -n 2 --dist worksteal

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(TREE)
	MYPYPATH=$(VENV)/tree $(BIN)/mypy
	cd $(VENV)/tree && ../bin/lint-imports --config ../../pyproject.toml

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[all,dev]'
	touch $@

clean:
	rm -rf $(VENV) demo-out build *.egg-info
