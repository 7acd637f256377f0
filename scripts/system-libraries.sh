#!/bin/sh
# The headless viewer needs EGL and a software renderer: install them where we may, else say what is skipped.
packages="libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
[ "$(uname)" = Linux ] || exit 0
missing=""
for package in $packages; do
  dpkg -s "$package" >/dev/null 2>&1 || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
command -v dpkg >/dev/null 2>&1 && command -v apt-get >/dev/null 2>&1 || {
  echo "note: no apt here; if the viewer finds no EGL, install Mesa's (on Debian:$missing). Without it 'dwgs render'," \
       "orbit.mp4 and the viewer's tests are skipped"
  exit 0
}
as_root=""
[ "$(id -u)" = 0 ] || as_root="sudo -n"
if $as_root true 2>/dev/null; then
  echo "installing$missing"
  $as_root apt-get update -qq >/dev/null 2>&1
  DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq $missing >/dev/null 2>&1 && exit 0
fi
echo "note: these packages are missing and may not be installed from here:$missing"
echo "      without them 'dwgs render', orbit.mp4 and the viewer's tests are skipped; ask for: apt-get install$missing"
