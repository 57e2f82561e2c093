# shellcheck shell=bash
# The scripts of this folder source this file. They first set `tool` to the name with which their messages begin.
# Afterwards `root` is the project's folder, its .venv is first on PATH, and compiled functions are cached in .cache.

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
export PATH=$root/.venv/bin:$PATH
export NUMBA_CACHE_DIR=${NUMBA_CACHE_DIR:-${TSA_CACHE:-$root/.cache}/numba}
unset PYTHONDONTWRITEBYTECODE # set in many containers; each of hundreds of starts would compile numpy and scipy again, 4 s

die() { # MESSAGE
    printf '%s: %s\n' "$tool" "$1" >&2
    exit 1
}

# Prints the first Python that is new enough: in .venv, then $PYTHON, then on PATH.
find_python() {
    local candidate
    for candidate in "$root/.venv/bin/python" "${PYTHON:-}" python3 python3.{11..15} python; do
        if [[ -n $candidate ]] && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$candidate"
            return
        fi
    done
    die "Python 3.11 or later is needed, found $(python3 --version 2>/dev/null || echo none); install it or name it in PYTHON"
}

# Creates .venv and installs the project into it, with an extra if one is given (dev: packages for tests and tools). Does
# nothing if this is done and pyproject.toml has not changed. An installation with an extra also serves a call without one.
ensure_venv() { # [EXTRA]
    local venv=$root/.venv log=$root/.cache/install.log python stamp extra=${1:-} size=570
    stamp="$root $(cksum <"$root/pyproject.toml")"
    if [[ $extra ]]; then
        stamp+=" $extra" size=810
    fi
    mkdir -p "$root/.cache"
    exec 9>"$root/.cache/install.lock"
    if command -v flock >/dev/null; then flock 9; fi
    if ! grep -qF "$stamp" "$venv/installed" 2>/dev/null; then
        python=$(find_python)
        printf '%s: installing into .venv (once; some %s MB on disk)\n' "$tool" "$size" >&2
        if [[ ! -x $venv/bin/python ]] || ! "$venv/bin/python" -m pip --version 2>/dev/null | grep -qF "$venv/"; then
            "$python" -m venv --clear "$venv" >"$log" 2>&1 ||
                die "'$python -m venv' failed (on Debian and Ubuntu: apt-get install python3-venv); see $log"
        fi
        # Byte code is written at first use, for the used modules only. The project is a plain line in a .pth file,
        # not a finder, which each start of Python would have to load first.
        "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --retries 2 --no-compile \
            --config-settings editable_mode=compat --editable "$root${extra:+[$extra]}" >"$log" 2>&1 ||
            die "pip could not install the project: $(grep -m1 ERROR "$log" || tail -n1 "$log")$(
                if grep -q 'connection broken' "$log"; then echo ' (a registry was not reached)'; fi
            ); all of it in $log"
        # The tests of these packages: 33 MB that nothing imports
        rm -rf "$venv"/lib/python3*/site-packages/{numpy,scipy,numba,matplotlib}{,/*,/*/*}/tests
        printf '%s\n' "$stamp" >"$venv/installed"
    fi
    exec 9>&-
}

# Compiles the plant, half a minute, unless a process has done so since its sources changed. A guest of tools/vcan would be
# slower, and its commands must be ready within a time-out. A failure is reported by the command that needs the plant.
compile_plant() {
    local sources=("$root"/tsa_ctrl/plant/*.py) newest source
    newest=${sources[0]}
    for source in "${sources[@]}"; do if [[ $source -nt $newest ]]; then newest=$source; fi; done
    if [[ ! $(find "$NUMBA_CACHE_DIR" -path '*/plant-*.nbi' -newer "$newest" -print -quit 2>/dev/null) ]]; then
        tsa simulate-loop "$root/config/controller.toml" "$root/config/plant.toml" --seconds 0.1 >/dev/null || true
    fi
}
