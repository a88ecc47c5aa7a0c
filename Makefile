# Two commands need nothing prepared but Python 3.11 and make: `make demo` and `make test`.
# Both set up .venv from requirements.lock first; the stamp in it makes the next run start at once.

PYTHON ?= $(shell command -v python3.11 || command -v python3.13 || command -v python3)
VENV ?= .venv
TESTS ?= tests
# Options of pytest that choose among tests: MARKS='-m "not thorough"'.
MARKS ?=
SMOKE := $(addprefix tests/cbt_terrain/,field/test_store.py importing/test_importing.py mesh/test_surface.py) \
	$(addprefix tests/cbt_terrain/,mosaic/test_finer_import.py refine/test_refinement.py test_terrain.py tree/test_tree.py) \
	$(addprefix tests/operators/,bridge/test_mesh_writer.py export/test_exporting.py session/test_session.py) \
	$(addprefix tests/operators/,test_handlers.py test_registration.py ui/test_panel.py) \
	$(addprefix tests/hard_cases/test_,camera_in_blender.py exports_in_blender.py life_in_blender.py)
# Left out there: what threads, kernels and signals do, which is the same on every Python.
EVERYWHERE_SAME := killed or ends_with_its_parent or leaves_no_folder or forced_splits or points_that_stay or warm_frame \
	or warm_build or was_stopped or interrupted or that_follow_others or depend_on_threads
PY := $(VENV)/bin/python
READY := $(VENV)/.ready

.PHONY: demo test test-core smoke test-all kernels fuzz hard-cases bench accuracy effects animation fly-over figures docs lint types format extension release clean help

help:
	@echo "make demo       the built-in island, 24 frames, pictures and a page in demo/"
	@echo "make test       every test (TESTS=tests/... for some)"
	@echo "make test-core  the engine alone without thorough tests, in two processes (after make kernels)"
	@echo "make smoke      a few tests of everything, a minute"
	@echo "make test-all   every test on Python 3.11 and 3.13 and in the real Blender program (Debian, root)"
	@echo "make kernels    compile all kernels now, so that nothing waits for them later"
	@echo "make fuzz       10,000 random views, thousands of damaged files and stores, 300 interrupts, more of the random tests"
	@echo "make hard-cases every hard case by its number"
	@echo "make bench      what everything costs on this machine (BENCH=--quick, or other options)"
	@echo "make accuracy   docs/accuracy.md: what accuracy costs on the island and on a real elevation model"
	@echo "make effects    docs/effects.md: what there is to read of a terrain, its pictures and costs"
	@echo "make animation  docs/animation.md: how far points pop, whether a scatter stands still, what a farm was seen to do"
	@echo "make fly-over   a flight over the demo's island through a farm's job in the real Blender program (Debian, root)"
	@echo "make figures    the figures of docs/method"
	@echo "make docs       the site of docs/ in site/; read it with python -m http.server -d site"
	@echo "make lint       ruff, typos, and mypy on the engine (make types for it alone)"
	@echo "make extension  the extension's zips for this platform in dist/, one for each Python"
	@echo "make release    all zips and a static extension repository in dist/repository, and the version's tag"

demo: $(READY)
	$(PY) -m adaptive_terrain.operators.cli.command_line demo --out demo

test: $(READY)
	$(PY) -m pytest $(TESTS) $(MARKS)

smoke: $(READY)
	$(PY) -m pytest $(SMOKE) -k "not ($(EVERYWHERE_SAME))" $(MARKS)

# The engine without the rooms that measure accuracy and shape land, and without tests marked `thorough`, in two
# processes that take about the same time: one has the rooms of files and of child processes, the other one all others.
ENGINE := tests/cbt_terrain
FILE_ROOMS := mosaic tiling importing exporting rasters formats run sandbox
define CORE_PARTS
tests/kernels $(ENGINE) $(addprefix --ignore=$(ENGINE)/,$(FILE_ROOMS) accuracy height_operators)
$(addprefix $(ENGINE)/,$(FILE_ROOMS))
endef
export CORE_PARTS
test-core: $(READY)
	echo "$$CORE_PARTS" | xargs -P 2 -L 1 $(PY) -m pytest -q -p no:cacheprovider -m "not thorough"

test-all: $(READY)
	tools/get_blender.sh trixie .cache/blender
	ADAPTIVE_TERRAIN_BLENDER=$(CURDIR)/.cache/blender.run $(PY) -m pytest tests
	$(MAKE) VENV=.venv-3.13 PYTHON=$$(command -v python3.13 || ls "$$(pyenv root)"/versions/3.13.*/bin/python) test

# Two processes: of two cores neither waits for the other.
kernels: $(READY)
	$(PY) -c "from adaptive_terrain.cbt_terrain.run import warmup as w; list(map(w.load, w.other_modules()))" & \
	$(PY) -c "from adaptive_terrain.cbt_terrain.run import warmup as w; w.start(); w.wait(overlay=True)" && wait $$!

fuzz: $(READY)
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/hard_cases -k "random_views_keep or every_format_in_every_order"
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/properties
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/hard_cases/test_interrupted_work.py
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/hard_cases -k "damaged_files_are or hostile_project_folder"
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/hard_cases/test_damaged_stores.py tests/blender/test_damaged_stores.py
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/cbt_terrain/mosaic/test_damaged_catalogues.py
	ADAPTIVE_TERRAIN_FUZZ=10000 $(PY) -m pytest tests/blender/test_long_runs.py -s

hard-cases: $(READY)
	$(PY) -m pytest --verbose tests/hard_cases

bench: $(READY)
	$(PY) -m adaptive_terrain.operators.cli.command_line bench $(BENCH)

accuracy: $(READY)
	$(PY) tools/write_accuracy.py

effects: $(READY)
	$(PY) tools/write_effects.py

animation: $(READY)
	$(PY) tools/write_animation.py

fly-over: $(READY) demo
	tools/get_blender.sh trixie .cache/blender
	$(PY) tools/fly_over.py --demo demo

figures: $(READY)
	$(PY) tools/draw_figures.py

# A small environment for the site alone: nothing of it is in requirements.lock. A dead link is an error.
docs: .venv-docs/.ready
	NO_MKDOCS_2_WARNING=1 .venv-docs/bin/python -m mkdocs build --quiet --strict

.venv-docs/.ready: tools/site_requirements.txt
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check --requirement tools/site_requirements.txt
	@touch $@

lint: $(READY) .venv-lint/.ready
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	.venv-lint/bin/typos
	$(MAKE) --no-print-directory types

# The checkout is the package, whatever its folder is called.
types: $(READY) .venv-lint/.ready
	@mkdir -p .cache/types && ln -sfn $(CURDIR) .cache/types/adaptive_terrain
	cd .cache/types && $(CURDIR)/.venv-lint/bin/python -m mypy --config-file $(CURDIR)/pyproject.toml \
		--python-executable $(abspath $(PY)) --cache-dir $(CURDIR)/.cache/mypy -p adaptive_terrain.cbt_terrain

# Its own pip would take six seconds.
.venv-lint/.ready: tools/lint_requirements.txt | $(READY)
	$(PYTHON) -m venv --without-pip .venv-lint
	$(PY) -m pip --python .venv-lint/bin/python install --quiet --disable-pip-version-check \
		--requirement tools/lint_requirements.txt
	@touch $@

format: $(READY)
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .

extension: $(READY)
	$(PY) tools/build_extension.py

# For another Blender than Debian's (as root): make release BLENDER=blender
BLENDER = .cache/blender.run blender
release: $(READY)
	[ "$(BLENDER)" != ".cache/blender.run blender" ] || tools/get_blender.sh trixie .cache/blender
	$(PY) tools/release.py --blender $(BLENDER)

$(READY): requirements.lock pyproject.toml tools/check_system.py
	@$(PYTHON) tools/check_system.py
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --requirement requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

clean:
	rm -rf demo fly_over dist build site .pytest_cache .hypothesis .ruff_cache
