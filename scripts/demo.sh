#!/usr/bin/env bash
# Sets everything up and runs the demonstration; it says at the end where the results lie.
# Arguments are passed on to `recon3d demo`.
set -euo pipefail
# shellcheck source=scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
set_up
cd "$root"
exec recon3d demo --output recon3d-output/demo "$@"
