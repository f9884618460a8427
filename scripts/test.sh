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
exec pytest "$@"
