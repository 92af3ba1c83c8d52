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

.PHONY: demo test check sanitize fuzz soak format clean

demo: $(READY)
	$(BIN)/tokt demo --out demo-out

# Some hundred processes are started: without bytecode on disk each compiles everything anew.
test: export PYTHONDONTWRITEBYTECODE =
test: $(READY)
	$(BIN)/python -m pytest -q -n 2 --dist loadgroup

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(TREE)
	MYPYPATH=$(VENV)/tree $(BIN)/mypy
	cd $(VENV)/tree && ../bin/lint-imports --config ../../pyproject.toml

# The compiled kernels with gcc's checks of memory and arithmetic, under a folder of their own.
# Python itself is not built that way: the checks' library is loaded first, and what Python keeps
# until it ends is no leak.
SANITIZED := $(VENV)/sanitized
sanitize: $(READY)
	rm -rf $(SANITIZED) && mkdir -p $(SANITIZED)/tokt/features
	ln -s $(CURDIR)/tokt/* $(SANITIZED)/tokt/
	for part in labels training models inference; do \
		ln -s $(CURDIR)/$$part $(SANITIZED)/tokt/$$part; done
	ln -s $(CURDIR)/features/*.py $(SANITIZED)/tokt/features/
	$(BIN)/cython -3 --module-name tokt.features._native features/native/kernels.pyx \
		-o $(SANITIZED)/_native.c
	gcc -shared -fPIC -O1 -g -ffp-contract=off -fno-omit-frame-pointer -Ifeatures/native \
		-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all \
		-I$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("include"))') \
		$(SANITIZED)/_native.c -lm -o $(SANITIZED)/tokt/features/_native$$($(BIN)/python \
		-c 'import sysconfig; print(sysconfig.get_config_var("EXT_SUFFIX"))')
	LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" \
		ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc \
		PYTHONPATH=$(CURDIR)/$(SANITIZED) PYTHONSAFEPATH=1 TOKT_KERNELS=compiled \
		$(BIN)/python -m pytest -q tests/features/test_kernels.py tests/features/test_area.py \
		tests/features/test_pictures.py tests/features/test_textures.py \
		tests/features/test_block_matching.py

# Half an hour and more: 10^5 changed bundles, 10^5 changed calibrations, labels and settings.
fuzz: $(READY)
	$(BIN)/python -m tests.fuzz

# 10^6 frames through the whole loop, with everything around it; on a machine that does nothing else.
soak: $(READY)
	$(BIN)/tokt bench --soak

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(READY): pyproject.toml constraints.txt $(wildcard features/native/*.h features/native/*.pyx)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[all,dev]'
	touch $@

clean:
	rm -rf $(VENV) demo-out bench-out build *.egg-info features/_native.*.so features/native/*.c
