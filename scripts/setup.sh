#!/usr/bin/env bash
# The set-up that demo.sh and test.sh share: checks the machine, makes .venv in the repository root and installs
# recon3d there in the versions of requirements.lock; does nothing where that is done. To source and call set_up, or
# by itself: bash scripts/setup.sh [EXTRA of pyproject.toml]
# PYTHON in the environment names the Python to make .venv with.
set -euo pipefail

root=$(unset CDPATH && cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
venv=$root/.venv

# What the user's own settings must not change: where pip installs, and what Python imports.
unset PIP_CONSTRAINT PIP_DRY_RUN PIP_NO_DEPS PIP_PREFIX PIP_PYTHON PIP_REQUIRE_HASHES PIP_ROOT PIP_TARGET PIP_USER
unset PYTHONHOME PYTHONPATH
export PATH # bash has one of its own where the environment has none

say() { printf 'set-up: %s\n' "$*"; }

die() {
    printf 'set-up: %s\n' "$*" >&2
    exit 1
}

quietly() { # COMMAND...: its output shows only if it fails
    local output
    output=$("$@" 2>&1 </dev/null) || {
        printf '%s\n' "$output" >&2
        return 1
    }
}

check_platform() {
    [[ $(uname -s) == Linux ]] || return 0
    local libc
    libc=$(getconf GNU_LIBC_VERSION 2>/dev/null) || die "Open3D needs a Linux with glibc 2.35 or newer; this one has no glibc"
    [[ $(printf '%s\n' 2.35 "${libc#glibc }" | sort -V | head -n 1) == 2.35 ]] ||
        die "Open3D needs glibc 2.35 or newer (Debian 12, Ubuntu 22.04); this system has $libc"
}

# The versions that Open3D 0.20 has wheels for.
version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null; }
is_supported() { [[ $1 =~ ^3\.1[1-4]$ ]]; }

find_python() { # sets python
    local candidate version found="" candidates=(python3 python3.14 python3.13 python3.12 python3.11)
    [[ -z ${PYTHON:-} ]] || candidates=("$PYTHON")
    for candidate in "${candidates[@]}"; do
        version=$(version_of "$candidate") || continue
        if is_supported "$version"; then
            python=$(command -v "$candidate")
            return
        fi
        found+="${found:+, }$candidate is Python $version"
    done
    die "Python 3.11, 3.12, 3.13 or 3.14 is needed (with its venv module), found: ${found:-no Python as ${candidates[*]}}." \
        "Install one (Debian, Ubuntu: apt-get install python3 python3-venv) or name it: PYTHON=/path/to/python3.12"
}

# Debian packages of what Open3D, numba and the making of .venv need and this Python does not find.
missing_packages() {
    "$python" - "$venv" <<'PYTHON'
import ctypes, importlib.util, sys

libraries = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
    "libstdc++.so.6": "libstdc++6",
}
for library, package in libraries.items() if sys.platform == "linux" else ():
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
if sys.prefix != sys.argv[1] and importlib.util.find_spec("ensurepip") is None:
    print("python%d.%d-venv" % sys.version_info[:2])
PYTHON
}

check_packages() {
    local packages command line as_root=(env)
    packages=$(missing_packages | tr '\n' ' ')
    packages=${packages% }
    [[ -n $packages ]] || return 0
    command -v apt-get >/dev/null ||
        die "this system lacks what Debian calls $packages; install these by its own package manager and try again"
    command="apt-get update && apt-get install -y --no-install-recommends $packages"
    if [[ $EUID -ne 0 ]]; then
        line="su - -c '$command'"
        ! command -v sudo >/dev/null || line="sudo sh -c '$command'"
        sudo -n true 2>/dev/null || die "system packages are missing; type: $line"
        as_root=(sudo -n env)
    fi
    say "installing system packages: $packages"
    # A fresh machine may still be busy with its own updates: wait for apt's lock.
    quietly "${as_root[@]}" DEBIAN_FRONTEND=noninteractive \
        sh -c "${command//apt-get /apt-get -q -o DPkg::Lock::Timeout=120 }" || die "this failed: $command"
    packages=$(missing_packages | tr '\n' ' ')
    [[ -z $packages ]] || die "$python still lacks what Debian calls $packages"
}

# A .venv works if its Python runs, has pip, was made in this place and lacks none of the files it installed.
venv_works() {
    is_supported "$(version_of "$venv/bin/python")" && grep -qsF "$venv/bin/" "$venv/bin/pip" &&
        "$venv/bin/python" - 2>/dev/null <<'PYTHON'
import sys
from importlib.metadata import distributions

import pip

for distribution in distributions():
    for file in distribution.files:  # None, an error, where the list itself is gone
        if file.suffix in (".py", ".so") and not file.locate().exists():
            sys.exit(1)
PYTHON
}

# What .venv was made from and holds; changes if anything is removed, added or renamed.
fingerprint() {
    (cd "$root" && cat pyproject.toml requirements.lock recon3d/_version.py && pwd &&
        version_of "$venv/bin/python" && LC_ALL=C ls "$venv"/lib/python*/site-packages "$venv/bin") 2>/dev/null | cksum
}

is_current() { # EXTRA
    local current
    current=$(fingerprint) || return 1
    [[ -x $venv/bin/recon3d && $current == "$(cat "$venv/recon3d-${1:-runtime}.stamp" 2>/dev/null)" ]]
}

set_up() { # [EXTRA]
    local extra=${1:-} python=$venv/bin/python
    check_platform
    if is_current "$extra" || { [[ -z $extra ]] && is_current dev; }; then
        check_packages # they may go, where .venv was kept and the system is new
        say "$venv is up to date"
    else
        if venv_works; then
            check_packages
        else
            find_python
            check_packages
            say "making $venv with $python (Python $(version_of "$python"))"
            quietly "$python" -m venv --clear "$venv" || die "making $venv failed"
        fi
        python=$venv/bin/python
        say "installing recon3d${extra:+ with extra $extra} and its dependencies, which takes minutes"
        rm -f "$venv"/recon3d-*.stamp
        quietly "$python" -m pip install --quiet --no-input --disable-pip-version-check --progress-bar off \
            -c "$root/requirements.lock" -e "$root${extra:+[$extra]}" || die "installing failed"
        quietly "$python" -c 'import open3d, recon3d' || die "Open3D was installed but does not load"
        fingerprint >"$venv/recon3d-${extra:-runtime}.stamp"
        say "compiling for this machine, once"
        "$python" -m recon3d.cli.precompile >/dev/null 2>&1 </dev/null || say "compiling is left to the first run"
        say "done"
    fi
    export PATH="$venv/bin:$PATH"
}

[[ ${BASH_SOURCE[0]} != "$0" ]] || set_up "$@"
