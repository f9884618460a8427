#!/usr/bin/env bash
# Sets everything up, then checks style, types and layers, and runs the tests. Arguments are passed on to pytest.
set -euo pipefail
# shellcheck source=scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
set_up dev
cd "$root"
ruff check
ruff format --check
mypy
lint-imports
# A worker a core, four at most: each needs a gigabyte; a file stays with one worker, for its fixtures.
exec pytest -n logical --maxprocesses 4 --dist loadfile "$@"
