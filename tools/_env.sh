# Sourced by tools/run and tools/test: makes .venv and installs what is needed into it.
# Usage: prepare "<extras>", e.g. prepare "" or prepare "dev".
# Set PYTHON to choose an interpreter (3.11), VENV to put the environment elsewhere.

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
venv="${VENV:-$root/.venv}"

say() { printf '%s\n' "$*" >&2; }

find_python() {
    for candidate in "${PYTHON:-}" python3.11 python3; do
        [ -n "$candidate" ] || continue
        if "$candidate" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then
            printf '%s' "$candidate"
            return
        fi
    done
    say "Python 3.11 is needed (PyBullet has wheels for no newer one)."
    say "Debian 12: apt install python3.11 python3.11-venv. Ubuntu: the same from a Python 3.11 repository."
    exit 2
}

# Off-screen rendering needs Mesa's EGL; without it the slower TinyRenderer is used.
install_egl() {
    if ldconfig -p 2>/dev/null | grep -q 'libEGL\.so\.1' && ls /usr/lib/*/dri/swrast_dri.so >/dev/null 2>&1; then
        return
    fi
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        say "Installing off-screen rendering (libegl1 libgl1-mesa-dri) ..."
        if { apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
            apt-get install -y -qq --no-install-recommends libegl1 libgl1-mesa-dri; } >/dev/null 2>&1; then
            return
        fi
    fi
    say "No EGL found: the slower TinyRenderer will be used. For the fast one:"
    say "    sudo apt install libegl1 libgl1-mesa-dri"
}

prepare() {
    local extras="$1" python stamp wanted
    python="$(find_python)" || exit 2
    install_egl
    if [ ! -x "$venv/bin/python" ]; then
        say "Making the virtual environment $venv ..."
        "$python" -m venv "$venv" || {
            say "Could not make it. Debian and Ubuntu: apt install python3.11-venv"
            exit 2
        }
    fi
    stamp="$venv/.installed-${extras:-base}"
    wanted="$(cat "$root/pyproject.toml" | cksum) $root"
    if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$wanted" ]; then
        say "Installing packages (a minute or two the first time) ..."
        "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -e "$root${extras:+[$extras]}" >&2 || {
            say "pip failed; its message is above."
            exit 2
        }
        printf '%s' "$wanted" >"$stamp"
    fi
    # The hand networks: 36 MB once per user, checked, and shared by all environments.
    "$venv/bin/python" -m cell.perception.hands.fetch >/dev/null || {
        say "Without the hand networks no person can be watched; --person none still works."
    }
}
