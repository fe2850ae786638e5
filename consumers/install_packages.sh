#!/usr/bin/env bash
# Install the Debian packages that the consumers are built with. Does nothing if all of them are present.
set -euo pipefail

packages=(
	# C++: the compiler, and the libraries beside OpenVINO, which comes with .venv
	g++ cmake ninja-build
	libopencv-core-dev libopencv-imgproc-dev libopencv-imgcodecs-dev libturbojpeg0-dev zlib1g-dev
	nlohmann-json3-dev libssl-dev doctest-dev
	# Browser: the browser of its tests, and a font. It also needs Node 20.19 or later with npm.
	chromium fonts-dejavu-core
)

missing=()
for package in "${packages[@]}"; do
	[[ $(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null) == installed ]] ||
		missing+=("$package")
done
[[ ${#missing[@]} -gt 0 ]] || exit 0
if [[ $EUID -ne 0 ]]; then
	echo "error: expected root, to install ${missing[*]}; got user $EUID. Run: sudo $0" >&2
	exit 1
fi
apt-get update --quiet=2
DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends "${missing[@]}"
