#!/bin/sh
# Installs the Debian libraries that Open3D (Embree), OSMesa and pyrender need, when it may; else prints the line to
# type. With the word tests also the browser in which the page of saltus watch is tested, and Cyclone DDS 0.10 for a
# peer in C.
set -eu
packages="libosmesa6 libgl1 libegl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6 libxrender1"
browser="chromium-headless-shell"
missing=""
for pair in libOSMesa.so:libosmesa6 libGL.so.1:libgl1 libEGL.so.1:libegl1 libgomp.so.1:libgomp1 \
    libidn2.so.0:libidn2-0 libudev.so.1:libudev1 libusb-1.0.so.0:libusb-1.0-0 libX11.so.6:libx11-6 \
    libXrender.so.1:libxrender1; do
    /sbin/ldconfig -p | grep -q "${pair%%:*}" || missing="$missing ${pair##*:}"
done
if [ "${1:-}" = tests ]; then
    command -v "$browser" >/dev/null || missing="$missing $browser"
    command -v idlc >/dev/null || missing="$missing cyclonedds-tools"
    [ -e /usr/include/dds/dds.h ] || missing="$missing cyclonedds-dev"
    command -v gcc >/dev/null || missing="$missing gcc"
fi
[ -n "$missing" ] || exit 0
line="apt-get install -y --no-install-recommends$missing"
if command -v apt-get >/dev/null 2>&1; then
    if [ "$(id -u)" = 0 ]; then
        apt-get update -q && exec $line
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        sudo apt-get update -q && exec sudo $line
    fi
    echo "Libraries are missing:$missing. Please type:  sudo $line" >&2
else
    echo "Libraries are missing; your system's packages that match Debian's $packages are needed." >&2
fi
exit 1
