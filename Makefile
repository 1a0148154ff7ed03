# Two front doors: `make demo` and `make test`. Each sets up what is missing. `make test` leaves out what takes
# long, `make test-all` runs every test.
VENV   := .venv
PYTHON ?= python3
BIN    := $(VENV)/bin
export PYTHONUNBUFFERED = 1
# Tests start hundreds of processes: each would compile all of Python's sources anew, a third of a second.
export PYTHONDONTWRITEBYTECODE =

.PHONY: demo test test-all bench chart paper wheels release image docs setup opengl lint clean
.PHONY: tools osmesa octave clang blender mitsuba basilisk chromium systemd

demo: setup
	$(BIN)/glrender demo --out out/demo

test: tools
	$(BIN)/ruff check .
	$(BIN)/python -m pytest -n 4 --dist loadfile --no-loadscope-reorder $(PYTEST_OPTIONS)

test-all: export GLRENDER_FUZZ_SECONDS ?= 15
test-all: PYTEST_OPTIONS = -m ""
test-all: test

bench: setup
	mkdir -p out/bench
	$(BIN)/python -m pytest benchmarks/bench_frame.py --benchmark-enable --benchmark-only -q \
	    --benchmark-json=out/bench/frame.json
	$(BIN)/python benchmarks/chart.py out/bench/frame.json out/bench
	$(BIN)/python benchmarks/bench_laws.py | tee out/bench/laws.json
	$(BIN)/python benchmarks/bench_service.py | tee out/bench/service.json
	$(BIN)/python benchmarks/bench_camera_model.py | tee out/bench/camera_model.json
	$(BIN)/python benchmarks/bench_camera_stages.py --chart out/bench/camera_stages.png | tee out/bench/camera_stages.json
	$(BIN)/python benchmarks/bench_transport.py | tee out/bench/transport.json
	$(BIN)/python benchmarks/bench_vizard.py | tee out/bench/vizard.json

chart: setup
	$(BIN)/python benchmarks/speed_accuracy.py
	$(BIN)/python benchmarks/navigation_chart.py

# Both cases of the SISPO paper, from frames to deviations: out/paper, about an hour on two cores.
paper: setup
	$(BIN)/python examples/paper/paper.py

# With the gallery of real frames where their data set is.
docs: setup
	@if [ -d "$${GLRENDER_SHARED:-../shared}/data/67p" ]; then \
	    $(BIN)/python examples/real_frames/real_frames.py --out out/real_frames; \
	else echo "no $${GLRENDER_SHARED:-../shared}/data/67p: the gallery of real frames is left out" >&2; fi
	$(BIN)/python -m sphinx -W --keep-going -q -c docs . out/site
	@echo "out/site/docs/index.html"

lint: setup
	$(BIN)/ruff check .
	$(BIN)/python -m pytest -q tests/system/test_types.py
	$(BIN)/codespell -L nees $$(git ls-files '*.md')
	$(BIN)/hadolint examples/service/Dockerfile

# Wheel and sdist, in clean environments of every Python from 3.11 to 3.13 that is here.
wheels: setup
	PYTHON=$(BIN)/python sh tools/try_wheel.sh

# Wheel and sdist, checked, with bill of materials, metadata for Zenodo and sums: out/release.
release: setup
	$(BIN)/python tools/release.py

image: setup
	$(BIN)/hadolint examples/service/Dockerfile
	docker build -f examples/service/Dockerfile -t glrender .

setup: $(VENV)/.ready opengl

$(VENV)/.ready: pyproject.toml tools/make_venv.sh
	sh tools/make_venv.sh $(PYTHON) $(VENV)
	touch $@

opengl: $(VENV)/.ready
	@sh tools/install_opengl.sh $(BIN)/glrender

# All that tests need besides; `make -j4 tools` brings them side by side.
tools: setup osmesa octave clang blender mitsuba basilisk chromium systemd

osmesa: $(VENV)/.ready
	@sh tools/install_osmesa.sh $(BIN)/glrender

octave:
	@sh tools/install_octave.sh

clang:
	@sh tools/install_clang.sh

blender: $(VENV)/.ready
	@sh tools/install_blender.sh $(BIN)/python

mitsuba: $(VENV)/.ready
	@sh tools/install_mitsuba.sh $(BIN)/python

basilisk: $(VENV)/.ready
	@sh tools/install_basilisk.sh $(BIN)/python

chromium:
	@sh tools/install_chromium.sh

systemd:
	@sh tools/install_systemd.sh

clean:
	rm -rf $(VENV) out
