#!/bin/sh
# Makes the environment .venv of this checkout, then runs a command in it:
#
#   sh setup.sh                    only set up
#   sh setup.sh dafw run           set up, then run the default study
#   sh setup.sh test [ARGUMENT...] set up, then lint, types and tests (arguments go to pytest)
#   sh setup.sh COMMAND...         set up, then run any other command where you stand
#
# An environment that is up to date is used at once and needs no network. Python packages stay in .venv and .uv of this
# folder; missing system packages are installed where that asks no password, otherwise the command to run is shown.
set -eu
unset PYTHONHOME

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
environment=$here/.venv

# What a bare Debian or Ubuntu may lack; dafw/commands/doctor.py knows what each is for and which of them are missing.
debian_packages="python3-venv python3-dev gcc libc6-dev libgl1 libglu1-mesa libgomp1 libxcursor1 libxft2 libxinerama1"

say() { echo "dafw: $*" >&2; }
die() { status=$1; shift; say "$*"; exit "$status"; }

stamp() { echo "$here"; cat "$here/requirements.lock" "$here/pyproject.toml" | cksum; }
up_to_date() { [ -x "$environment/bin/python" ] && [ "$(cat "$environment/stamp" 2>/dev/null)" = "$(stamp)" ]; }

# Shims of a version manager may be there and fail, an old uv may lack an option: only trying tells.
uv_works() { "$1" venv --relocatable --managed-python --help >/dev/null 2>&1; }
runs_dafw() { "$1" -c 'import sys; sys.exit(not (3, 12) <= sys.version_info < (3, 14))' </dev/null 2>/dev/null; }
brings_pip() { "$1" -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 9))' </dev/null 2>/dev/null; }

pythons() ( # all that PATH names, and those that the shims of pyenv hide
    IFS=:
    for name in python3.12 python3.13 python3; do
        for folder in $PATH; do if [ -x "$folder/$name" ]; then echo "$folder/$name"; fi; done
    done
    for path in "${PYENV_ROOT:-${HOME:-}/.pyenv}"/versions/3.1[23].*[0-9]/bin/python3; do echo "$path"; done
)
first_python_that() (
    pythons | { while read -r path; do if "$1" "$path"; then echo "$path" && exit; fi; done; exit 1; }
)

# shellcheck disable=SC2086 # $1 is a list
install_system_packages() {
    command -v apt-get >/dev/null || die 2 "missing; install with your package manager what Debian calls: $1"
    if [ "$(id -u)" = 0 ]; then root=""; elif sudo -n true 2>/dev/null; then root="sudo -n"; else
        die 2 "system packages are missing; run this, then call again:" \
            "sudo apt-get update && sudo apt-get install -y --no-install-recommends $1"
    fi
    say "installing system packages: $1"
    $root apt-get -qq update || say "the package lists could not be refreshed; trying with those that are here"
    $root env DEBIAN_FRONTEND=noninteractive \
        apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends $1 \
        >>"$here/.uv/apt.log" || die 2 "system packages could not be installed (see above and .uv/apt.log): $1"
}

find_uv() {
    for uv in uv "$here/.uv/tool/bin/uv"; do if uv_works "$uv"; then return; fi; done
    if ! python=$(first_python_that brings_pip); then
        install_system_packages "$debian_packages"
        python=$(first_python_that brings_pip) || die 2 "no Python >= 3.9 with pip here; install one, or uv, call again"
    fi
    say "installing uv for this folder"
    "$python" -m venv --clear "$here/.uv/tool" || die 1 "$python could not make an environment for uv (see above)"
    "$here/.uv/tool/bin/python" -m pip install --quiet --disable-pip-version-check uv ||
        die 1 "uv could not be installed (see above)"
}

make_environment() {
    rm -rf "$environment"
    if python=$(first_python_that runs_dafw); then
        say "making the environment $environment with $python"
        "$uv" venv --quiet --relocatable --python "$python" "$environment" || die 1 "that failed (see above)"
    else
        say "making the environment $environment with the Python 3.12 of uv, which it may download"
        "$uv" venv --quiet --relocatable --managed-python --python 3.12 "$environment" ||
            die 2 "no Python 3.12 or 3.13, no download (see above); install one (say: pyenv install 3.12), call again"
    fi
}

prepare() ( # a subshell: the command starts where the caller stands; descriptor 9 is the lock
    cd "$here" # where .python-version steers the shims of pyenv
    if command -v flock >/dev/null && ! flock -n 9; then say "waiting for another set-up of this folder"; flock 9; fi
    if up_to_date; then exit; fi
    find_uv
    # .uv/building survives an interruption: what that left behind is not taken for an environment
    if [ -e .uv/building ] || ! runs_dafw "$environment/bin/python"; then : >.uv/building; make_environment; fi
    : >.uv/building
    say "installing the packages of requirements.lock (about 1.4 GB on disk)"
    "$uv" pip install --quiet --python "$environment/bin/python" --require-hashes -r requirements.lock ||
        die 1 "the packages of requirements.lock could not be installed (see above)"
    "$uv" pip install --quiet --python "$environment/bin/python" --no-deps --no-build-isolation -e . ||
        die 1 "dafw itself could not be installed (see above)"
    rm .uv/building
    missing=$("$environment/bin/python" dafw/commands/doctor.py --packages)
    if [ -n "$missing" ]; then install_system_packages "$missing"; fi
    report=$("$environment/bin/python" dafw/commands/doctor.py --system) || die 2 "the system is not ready:
$report"
    say "compiling what a run imports"
    "$environment/bin/python" dafw/commands/first_imports.py || die 1 "what a run needs cannot be imported (see above)"
    stamp >"$environment/stamp.new"
    mv "$environment/stamp.new" "$environment/stamp"
)

install_browser() { # for the tests of the page that `dafw report` writes
    for browser in chromium chromium-browser google-chrome; do
        if command -v "$browser" >/dev/null; then return; fi
    done
    (install_system_packages chromium) || say "no browser: the tests of the page are skipped"
}

install_broker() { # for the tests of live runs through MQTT; Debian keeps it where only root's PATH leads
    if { command -v mosquitto || [ -x /usr/sbin/mosquitto ]; } && command -v openssl; then return; fi >/dev/null
    (install_system_packages "mosquitto openssl") || say "no broker: the tests of MQTT are skipped"
}

case ${1:-} in -h | --help) sed -n '2,/^set/{/^#/s/^# \{0,1\}//p;}' "$0" && exit ;; esac

if ! up_to_date; then
    mkdir -p "$here/.uv"
    prepare </dev/null >&2 9>"$here/.uv/lock" # standard output belongs to the command
fi

export PATH="$environment/bin:$PATH" VIRTUAL_ENV="$environment"
case ${1:-} in
    "") say "ready: sh $0 dafw run" ;;
    test)
        shift
        cd "$here"
        install_browser </dev/null >&2
        install_broker </dev/null >&2
        ruff check
        ruff format --check
        mypy
        # Containers often forbid bytecode; then each of the many processes would compile the tests and what they import.
        unset PYTHONDONTWRITEBYTECODE
        exec pytest -q -n 2 --dist worksteal "$@" ;;
    *) exec "$@" ;;
esac
