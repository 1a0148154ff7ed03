# Sourced: apt_install PACKAGE... installs, or prints the line to type and fails.
apt_install() {
    if ! command -v apt-get >/dev/null; then
        echo "Please install with your system's package manager: $*" >&2
        return 1
    fi
    if [ "$(id -u)" = 0 ]; then
        sudo=
    elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        sudo="sudo -n"
    else
        echo "Please type: sudo apt-get update && sudo apt-get install -y $*" >&2
        return 1
    fi
    lock=${TMPDIR:-/tmp}/glrender-apt-$(id -u).lock
    # One at a time: `make -j` brings several tools at once.
    (
        flock 9
        # Lists of packages that another tool has fetched within the hour are new enough.
        if [ -z "$(find "$lock.updated" -mmin -60 2>/dev/null)" ]; then
            $sudo apt-get update -qq && touch "$lock.updated" || true
        fi
        install="env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends"
        # Lists that have gone or changed since are fetched again.
        $sudo $install "$@" >/dev/null 2>&1 || { $sudo apt-get update -qq || true; $sudo $install "$@" >/dev/null; }
    ) 9>"$lock"
}
