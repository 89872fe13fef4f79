# The Python environment is .venv; PYTHON=... chooses what it is made with. bin=/path/to/bin takes one that is there.
bin := .venv/bin
RANKS := 2
# Processes share the cores, so each has one thread.
alone := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
stamp := $(if $(filter .venv/bin,$(bin)),.venv/.stamp)

.PHONY: help demo test docs lint dist clean distclean test-debian compiler

help: ## list these targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1 - \2/p' Makefile

demo: compiler $(stamp) ## the whole chain on a stretched monolayer; figure and fields in results/demo
	@$(bin)/tsgdd demo --out results/demo

test: compiler $(stamp) ## all tests, a process a core, then those marked mpi on RANKS=2; ARGS="-k name" goes to pytest
	$(alone) $(bin)/python -m pytest --numprocesses auto --dist loadfile $(ARGS)
	PATH="$(abspath $(bin)):$$PATH" $(alone) mpirun -n $(RANKS) $(bin)/python -m pytest -m mpi $(ARGS)

docs: compiler .venv/.docs ## these pages, tutorials run, into docs/_build/html; warnings are errors
	$(bin)/python -m sphinx --fail-on-warning --keep-going --quiet -b html docs docs/_build/html

lint: $(stamp) ## ruff and mypy
	$(bin)/ruff check
	$(bin)/ruff format --check
	$(bin)/mypy

dist: ## sdist and wheel in dist/, tried in environments of their own
	@.ci/dist

test-debian: ## the tests on Debian 13's python3-dolfinx, in a tree by debootstrap (root)
	@.ci/test-debian $(ARGS)

clean: ## remove results and caches
	rm -rf results dist docs/_build docs/gallery docs/generated .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -not -path './.debian/*' -prune -exec rm -rf {} +

distclean: clean ## remove .venv too
	rm -rf .venv

compiler:
	@.ci/check-compiler

.venv/.stamp: pyproject.toml
	@$(bin)/python -c '' 2>/dev/null || { python=$$(.ci/find-python) && "$$python" -m venv --clear .venv; }
	@echo "Installing tsgdd and its dependencies into .venv (about a minute; 2.4 GB) ..."
	@$(bin)/python -m pip install --quiet --disable-pip-version-check --editable '.[all]'
	@touch $@

.venv/.docs: .venv/.stamp
	@echo "Installing Sphinx into .venv ..."
	@$(bin)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@
