#!/bin/sh
# Build wheel and sdist, and try both in a clean environment of every Python 3.11 to 3.13 here: try_wheel.sh [FOLDER]
# VERSIONS="3.12" tries these. A Python that is not here is told. The wheel draws a frame, serves and is uninstalled;
# the sdist is built where the wheel was, and tells its version.
set -eu
cd "$(dirname "$0")/.."
builder=${PYTHON:-.venv/bin/python}
case $builder in */*) builder=$(cd "$(dirname "$builder")" && pwd)/$(basename "$builder") ;; esac
out=${1:-out/wheel}
rm -rf "$out" && mkdir -p "$out" && out=$(cd "$out" && pwd)
"$builder" -m hatchling build -d "$out" >/dev/null

try() {
    python=$1 file=$2 place=$3
    mkdir -p "$place/home" "$place/work"
    # The sdist is tried where the wheel was, and left nothing but what both need.
    [ -d "$place/env" ] || "$python" -m venv "$place/env"
    "$place/env/bin/python" -m pip install --no-compile --quiet --disable-pip-version-check "$file"
    (
        cd "$place/work"
        unset PYTHONPATH GLRENDER_CACHE NUMBA_CACHE_DIR XDG_CACHE_HOME
        export HOME="$place/home" PATH="$place/env/bin:$PATH"
        glrender --version
        case $file in *.tar.gz) exit 0 ;; esac
        glrender init >/dev/null
        glrender render scene.toml --max-error 0.2 --out frame.png
        python - <<'PYTHON'
import subprocess, sys
from importlib.metadata import version
from glrender_client import Client

command = ["glrender-server", "scene.toml", "--zmq", "tcp://127.0.0.1:*"]
server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
try:
    endpoint = next(line.split()[3] for line in server.stdout if line.startswith("glrender-server ready on"))
    with Client(endpoint, timeout_s=60.0) as client:
        assert client.hello()["bodies"], "a server without a body"
finally:
    server.terminate()
    server.wait()
sys.stdout.write(f"glrender {version('glrender')} served\n")
PYTHON
        pip uninstall --quiet --yes glrender
        left=$(find "$place/env" -path '*glrender*' -type f ! -name '*.nbi' ! -name '*.nbc' ! -name '*.pyc')
        # rustup's shims, where a machine has them, write a file of their own.
        outside=$(find "$place/home" -type f ! -path "$place/home/.cache/glrender/*" ! -path "$place/home/.rustup/*")
        if [ -n "$left$outside" ]; then
            echo "files that neither the environment nor the cache folder should have: $left $outside" >&2
            exit 1
        fi
    )
}

# The interpreter of a version: on the path, or pyenv's, whose shims may lead nowhere.
interpreter() {
    for candidate in "$(command -v "python$1")" "$HOME"/.pyenv/versions/"$1".*/bin/"python$1"; do
        if "$candidate" -c '' 2>/dev/null; then
            echo "$candidate"
            return 0
        fi
    done
    return 1
}

tried=0
for version in ${VERSIONS:-3.11 3.12 3.13}; do
    if ! python=$(interpreter "$version"); then
        echo "python$version is not here: not tried" >&2
        continue
    fi
    for file in "$out"/*.whl "$out"/*.tar.gz; do
        echo "== $python, $(basename "$file")"
        try "$python" "$file" "$out/try-$version"
        tried=$((tried + 1))
    done
    rm -rf "$out/try-$version"
done
[ "$tried" -gt 0 ]
echo "tried: $tried"
