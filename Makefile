# SPDX-License-Identifier: AGPL-3.0-or-later
# The front door. `make demo` and `make test` do all the set-up themselves on a bare Debian 12.
#   make demo        the marble bunny, from nothing to a picture
#   make test        every test
#   make bench       run time against error, drawn
#   make SCENE=path [OUT=dir] [image.png or any artefact of the scene]
SHELL := /bin/bash
BUILD ?= build
JOBS ?= 2
SCENE ?= assets/scenes/marble-bunny.json
OUT ?= out/$(basename $(notdir $(SCENE)))

.DEFAULT_GOAL := image.png
.PHONY: setup configure build test demo bench format check-format sanitize accuracy stress report clean FORCE

setup:
	@bash .ci/install-packages

configure: setup
	@cmake --preset release -DCMAKE_MESSAGE_LOG_LEVEL=WARNING > /dev/null

build: configure
	@cmake --build --preset release --parallel $(JOBS)

test: build
	@ctest --preset release

format:
	@git ls-files '*.h' '*.cpp' | xargs clang-format -i

check-format:
	@git ls-files '*.h' '*.cpp' | xargs clang-format --dry-run -Werror

sanitize: setup
	@cmake --preset sanitize > /dev/null
	@cmake --build --preset sanitize --parallel $(JOBS)
	@ctest --preset sanitize

accuracy stress: build
	@SG_LONG=1 ctest --preset release -L $@

clean:
	rm -rf $(BUILD) out
