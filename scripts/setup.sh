# Sourced by the scripts beside it and by .ci/run: puts uv on the PATH and makes sure that something can draw
# offscreen. What is missing is installed with Debian's apt-get, or the exact command is printed where that takes another
# user.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
PATH="$root/.uv/bin:$PATH"

install_debian() {
  local install=(apt-get install -y --no-install-recommends "$@") as_root=()
  if [[ $(id -u) != 0 ]]; then as_root=(sudo); fi
  if ! command -v apt-get >/dev/null || { ((${#as_root[@]})) && ! sudo -n true 2>/dev/null; }; then
    echo "simgrab needs $*. Run:  sudo apt-get update && sudo ${install[*]}" >&2
    exit 2
  fi
  echo "installing $*" >&2
  "${as_root[@]}" apt-get update -qq >&2
  DEBIAN_FRONTEND=noninteractive "${as_root[@]}" "${install[@]}" -qq >&2
}

missing=()
command -v python3 >/dev/null || missing+=(python3)
if ! command -v uv >/dev/null && ! python3 -c 'import ensurepip, venv' 2>/dev/null; then
  missing+=(python3-venv)
fi
# The package's own choice of OpenGL, which needs nothing but the standard library.
if ! (cd "$root" && python3 -S -c 'from simgrab.world import gl; raise SystemExit(gl.choose() == "disabled")' 2>/dev/null); then
  missing+=(libegl1 libgl1 libgl1-mesa-dri)
fi
if ((${#missing[@]})); then install_debian "${missing[@]}"; fi
if ! command -v uv >/dev/null; then
  echo "installing uv into $root/.uv" >&2
  python3 -m venv "$root/.uv"
  "$root/.uv/bin/pip" install --quiet --disable-pip-version-check uv
fi
