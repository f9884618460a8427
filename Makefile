.PHONY: help demo test bench lock

help:
	@echo "make demo    set up, reconstruct the built-in scene, say where the results lie"
	@echo "make test    set up, check style, types and layers, run the tests"
	@echo "make bench   measure time and memory"
	@echo "make lock    renew requirements.lock"

demo:
	bash scripts/demo.sh

test:
	bash scripts/test.sh

bench:
	bash scripts/setup.sh
	.venv/bin/python scripts/benchmark.py

lock:
	bash scripts/setup.sh
	.venv/bin/python -m pip install --quiet --disable-pip-version-check uv
	{ echo '# Every version that pip installs, for Python 3.11 and newer on all systems; made by: make lock' && \
	  .venv/bin/uv pip compile --quiet --universal --python-version 3.11 --extra dev --no-annotate --no-header \
	    pyproject.toml; } >requirements.lock.new
	mv requirements.lock.new requirements.lock
