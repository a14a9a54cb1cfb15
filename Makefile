# make demo, make test, make lint, make fuzz, make faults: each installs what it needs into .venv/<distro> first.

PYTHON ?= python3
DISTRO ?= jazzy
VENV ?= .venv/$(DISTRO)
OUTPUT ?= demo_output
MODE ?= step

BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

.PHONY: demo test lint fuzz faults clean

demo: $(INSTALLED)
	@$(BIN)/panodepth_ros demo --mode $(MODE) --output $(OUTPUT)

test: $(INSTALLED)
	@$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(INSTALLED)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

fuzz: $(INSTALLED)
	@$(BIN)/python -m benchmarks.fuzz

faults: $(INSTALLED)
	@$(BIN)/python -m benchmarks.faults --output docs/reliability.md

$(INSTALLED): setup.py pyproject.toml requirements/$(DISTRO).txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || { \
	  echo 'panodepth_ros needs Python 3.10 or later as $(PYTHON); install it, or name another: make PYTHON=python3.12' >&2; \
	  exit 1; }
	@[ "$$(uname -sm)" = 'Linux x86_64' ] || { \
	  echo 'ROS 2 comes as wheels for Linux on x86_64 only; install ROS 2 from its distribution and use colcon build (README, Install)' >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo 'panodepth_ros needs the venv module of $(PYTHON); install it: sudo apt install python3-venv' >&2; \
	  exit 1; }
	@echo 'installing ROS 2 $(DISTRO) and panodepth_ros into $(VENV)'
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV)
	@touch $(VENV)/COLCON_IGNORE
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[$(DISTRO),bag,plot,report,test]'
	@touch $@

clean:
	rm -rf .venv build install log demo_output *.egg-info
