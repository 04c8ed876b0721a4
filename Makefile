# SPDX-License-Identifier: AGPL-3.0-or-later
# The front door. `make demo` and `make test` do all the set-up themselves on a bare Debian 12.
#   make demo        the marble bunny, from nothing to a picture
#   make test        every test
#   make bench       run time against error, drawn (SG_LONG=1: larger problems, more repetitions)
#   make geometry-report [MESHES=folder] [OUT=dir] [NODES=1e5] [LIMIT=n] [JOBS=1]
#                    every mesh of libcgal-demo (and of a folder) up to its polygrid: a table and pictures
#   make synthesis-report [MESHES=folder] [OUT=dir] [SAMPLES='name name'] [ONLY='name name'] [SIZE=80]
#                    samples of every source on bunny, armadillo, spot (of MESHES, else a shape of our own) and a genus-3
#                    shape: pictures, time, memory, figures of quality, the default way beside the paper's
#   make stf-report [OUT=dir] [ONLY='part part'] [WIDTH=240] [PATHS=1]
#                    shell texture functions: pictures, their errors and times against light paths (SG_LONG=1: larger, finer)
#   make diffusion-map [OUT=dir]
#                    the error of diffusion against sg-reference, a table and a picture (SG_LONG=1: all of it)
#   make SCENE=path [OUT=dir] [image.png or any artefact of the scene; views; report]
#   make docs        the README's tables of options and scene keys, from the programs' own help
SHELL := /bin/bash
BUILD ?= build
JOBS ?= 2
SCENE ?= assets/scenes/marble-bunny.json
OUT ?=
FLAGS ?=
MESHES ?=
NODES ?= 1e5
LIMIT ?= 0

# Names of scenes and folders are data: they go to the shell in the environment, and Make never expands them.
override SCENE := $(value SCENE)
override OUT := $(value OUT)
override MESHES := $(value MESHES)
MAKEOVERRIDES :=
export SCENE OUT MESHES

.DEFAULT_GOAL := image.png
ARTEFACTS := all views report image.png image.exr exitance.ply reference.ply core.ply stf.vdb fluence.hdf polygrid.hdf polycube.hdf tets.hdf shell.vdb \
  synthesized.ply textons.vdb sample.vdb core-sample.vdb $(foreach n,2 3 4 5 6 7 8,sample-$(n).vdb) distance.vdb surface.ply \
  polygrid.view.ply polycube.view.ply shell.view.ply textons.view.ply sample.view.ply stf.view.ply distance.view.ply
.PHONY: setup configure build programs test demo bench geometry-report synthesis-report stf-report diffusion-map docs format check-format sanitize accuracy stress clean $(ARTEFACTS)

setup:
	@bash .ci/install-packages

configure: setup
	@cmake --preset release -DCMAKE_MESSAGE_LOG_LEVEL=WARNING > /dev/null

build: configure
	@cmake --build --preset release --parallel $(JOBS)

# The programs alone: what a picture needs.
stages := $(subst _,-,$(basename $(notdir $(wildcard pipeline/stages/sg_*.cpp))))
programs: configure
	@cmake --build --preset release --parallel $(JOBS) --target $(stages)

test: build
	@ctest --preset release

# Meshes of Debian's libcgal-demo, by their names there.
meshes := /usr/share/doc/libcgal-dev/data.tar.gz
assets/meshes/%.off: | setup
	@mkdir -p $(@D)
	@tar -xzOf $(meshes) data/meshes/$*.off > $@.partial
	@mv $@.partial $@

# The paint of assets/scenes/painted-bunny.json.
painted := assets/meshes/painted-bunny.ply
$(painted): assets/meshes/bunny00.off assets/scenes/paint.py
	@/usr/bin/python3 -B assets/scenes/paint.py $< $@.partial \
	  'sample = y < 0.1 + 0.2 * sin(5 * x + 2 * z)' 'scale = 1.1 - 0.4 * y' && mv $@.partial $@
own_paint = $(if $(findstring painted-bunny,$(value SCENE)),$(painted))

# The artefacts of SCENE lie in OUT, or out/NAME for a scene NAME.json.
find_out = name=$${SCENE\#\#*/}; out=$${OUT:-out/$${name%.*}}

$(ARTEFACTS): programs assets/meshes/bunny00.off $(own_paint)
	@$(find_out); $(BUILD)/bin/sg-plan -q -o "$$out" -- "$$SCENE" && \
	  $(MAKE) --no-print-directory -C "$$out" $@ FLAGS='$(FLAGS)'

demo: override SCENE := assets/scenes/marble-bunny.json
demo: programs assets/meshes/bunny00.off
	@$(find_out); started=$$(date +%s.%N); $(BUILD)/bin/sg-plan -q -o "$$out" -- "$$SCENE" && \
	  $(MAKE) --no-print-directory -C "$$out" all report FLAGS='$(FLAGS)' && \
	  echo && printf '%-9s %s\n' picture "$$out/image.png" report "$$out/report.html" && \
	  for view in "$$out"/*.ply; do printf '%-9s %s\n' view "$$view"; done && \
	  printf '%-9s %s\n' records "$$out/*.json" && \
	  awk -v from=$$started -v to=$$(date +%s.%N) 'BEGIN {printf "%-9s %.1f s\n", "time", to - from}'

# The bunny's grids for the diffusion benchmark; the finest one judges the others' discretisation.
bunny := out/bench/bunny
bunny_sizes := 1e5 3e5 1e6 $(if $(SG_LONG),3e6)
$(bunny)/surface.ply: assets/meshes/bunny00.off | programs
	@mkdir -p $(@D) && $(BUILD)/bin/sg-prepare -q $< -o $@ --size 80 --spacing 0.5
$(bunny)/tets.hdf: $(bunny)/surface.ply
	@$(BUILD)/bin/sg-tetrahedralize -q $< -o $@
$(bunny)/polycube-%.hdf: $(bunny)/tets.hdf
	@$(BUILD)/bin/sg-polycube -q $< -o $@ --nodes $*
$(bunny)/polygrid-%.hdf: $(bunny)/polycube-%.hdf $(bunny)/surface.ply
	@echo "bunny, $* nodes" && $(BUILD)/bin/sg-polygrid -q $^ -o $@
# Tetrahedra with about as many points: the spacing follows from the object's 102 560 mm³.
tetrahedra_spacing = $(shell awk 'BEGIN {printf "%.3f", (1.32 * 102560 / $(1)) ^ (1 / 3)}')
$(bunny)/tets-%.hdf: assets/meshes/bunny00.off | programs
	@echo "bunny, $* points of tetrahedra" && mkdir -p $(@D) && \
	  $(BUILD)/bin/sg-prepare -q $< -o $(bunny)/surface-$*.ply --size 80 --spacing $(call tetrahedra_spacing,$*) && \
	  $(BUILD)/bin/sg-tetrahedralize -q $(bunny)/surface-$*.ply -o $@ --spacing $(call tetrahedra_spacing,$*) \
	    --proxy-faces 1e8 --limit 3600
.SECONDARY:

bench: build assets/meshes/bunny00.off $(bunny_sizes:%=$(bunny)/polygrid-%.hdf) \
    $(patsubst %,$(bunny)/tets-%.hdf,$(filter-out $(if $(SG_LONG),,1e6),$(bunny_sizes)))
	@mkdir -p out/bench
	@$(BUILD)/bin/multigrid_benchmark $(bunny)/polygrid-1e6.hdf > out/bench/multigrid.txt && cat out/bench/multigrid.txt
	@for program in $(BUILD)/bin/*_benchmark; do \
	  [ -x "$$program" ] || continue; name=$$(basename "$$program" _benchmark); echo "$$name"; \
	  case "$$name" in multigrid) continue;; diffusion|diffusion_cost) inputs=$(bunny);; *) inputs=;; esac; \
	  "$$program" $$inputs > "out/bench/$$name.csv" && cat "out/bench/$$name.csv" || exit 1; \
	  plot="tests/benchmarks/$$name.gnuplot"; \
	  if [ -f "$$plot" ]; then gnuplot -e "csv='out/bench/$$name.csv'; picture='out/bench/$$name.png'" "$$plot" || exit 1; fi; \
	done
	@SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/report/cost_charts.py assets/meshes/bunny00.off -o out/bench
	@SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/report/shell_texture_cost.py -o out/bench --bunny assets/meshes/bunny00.off

# LIMIT=n: the n smallest meshes only; ONLY='name name': these. SG_LONG=1: also time and memory against nodes and voxels.
geometry-report: programs
	@out=$${OUT:-out/geometry-report}; folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && \
	  tar -xzf $(meshes) -C "$$folder" data/meshes && \
	  SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/report/geometry_report.py -o "$$out" --nodes $(NODES) --least $(LIMIT) \
	    --jobs $(if $(filter command,$(firstword $(origin JOBS))),$(JOBS),1) $(if $(ONLY),--only $(ONLY)) -- "$$folder/data/meshes" $${MESHES:+"$$MESHES"}; \
	  code=$$?; [ -z "$$SG_LONG" ] || SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/report/cost_charts.py \
	    "$$folder/data/meshes/bunny00.off" -o "$$out" || code=1; exit $$code

# SAMPLES='name name': these of assets/samples, or descriptions of your own; ONLY='name name': these shapes.
synthesis-report: programs
	@out=$${OUT:-out/synthesis-report}; folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && \
	  tar -xzf $(meshes) -C "$$folder" data/meshes && \
	  SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/report/synthesis_report.py -o "$$out" \
	    $(if $(SIZE),--size $(SIZE)) $(if $(SAMPLES),--samples $(SAMPLES)) $(if $(ONLY),--meshes $(ONLY)) -- $${MESHES:+"$$MESHES"} "$$folder/data/meshes"

# ONLY='part part': parts layers shadow reference gallery. WIDTH: of the pictures, pixels; PATHS: factor on the light paths.
stf-report: programs assets/meshes/bunny00.off
	@SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/report/stf_report.py -o "$${OUT:-out/stf-report}" --bunny assets/meshes/bunny00.off \
	  $(if $(ONLY),--only $(ONLY)) $(if $(WIDTH),--width $(WIDTH)) $(if $(PATHS),--paths $(PATHS))

# Sphere, plate and bunny by albedo, thickness and source. SG_LONG=1: finer grids, less noise, six albedos by five thicknesses.
diffusion-map: programs assets/meshes/bunny00.off
	@SG_BIN=$(BUILD)/bin /usr/bin/python3 -B tests/accuracy/diffusion_map.py -o "$${OUT:-out/diffusion-map}" \
	  --bunny assets/meshes/bunny00.off

docs: programs
	@SG_BIN=$(BUILD)/bin /usr/bin/python3 -B pipeline/readme_tables.py README.md

format:
	@git ls-files '*.h' '*.cpp' | xargs clang-format -i

check-format:
	@git ls-files '*.h' '*.cpp' | xargs clang-format --dry-run -Werror

sanitize: setup
	@cmake --preset sanitize -DCMAKE_MESSAGE_LOG_LEVEL=WARNING > /dev/null
	@cmake --build --preset sanitize --parallel $(JOBS)
	@ctest --preset sanitize --parallel $(JOBS); code=$$?; cat build-sanitize/findings/summary.txt; exit $$code

accuracy stress: build
	@SG_LONG=1 ctest --preset release -L $@

clean:
	rm -rf $(BUILD) out
