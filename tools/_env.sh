# Shared by the scripts of this folder; sourced with `tool` set to the name that messages begin with.
# After it `root` is the project's folder, its .venv comes first on PATH, and the current folder is unchanged.

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
PATH=$root/.venv/bin:$PATH

die() { # MESSAGE [STATUS]
    printf '%s: %s\n' "$tool" "$1" >&2
    exit "${2:-1}"
}

python_new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

# Prints the first Python that is new enough: the project's own, then $PYTHON, then what PATH has.
find_python() {
    local candidate
    for candidate in "$root/.venv/bin/python" "${PYTHON:-}" python3 python3.{11..19} python; do
        if [[ -n $candidate ]] && python_new_enough "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
    die "needs Python 3.11 or later, found $(python3 --version 2>&1 || echo none); install it or name it in PYTHON"
}
