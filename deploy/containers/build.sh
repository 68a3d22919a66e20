#!/usr/bin/env bash
# The container image with all programs, by podman or docker. Sources are fetched once for each lock file; the build itself
# has no network.
#
#   deploy/containers/build.sh [TAG]     [default: fiatlux]
set -euo pipefail
cd "$(dirname "$0")/../.."
tag="${1:-fiatlux}"
engine="$(command -v podman || command -v docker)" || {
    echo "build.sh: neither podman nor docker is installed; install one of them, or build the programs with cargo" >&2
    exit 1
}
for base in docker.io/library/rust:1.95.0-bookworm docker.io/library/debian:bookworm-slim; do
    "$engine" pull "$base"
done
cargo vendor --locked --versioned-dirs deploy/containers/vendor >/dev/null
ignore=()
# Docker finds the list next to the Containerfile by itself.
[ "$(basename "$engine")" = podman ] && ignore=(--ignorefile deploy/containers/Containerfile.dockerignore)
"$engine" build --network none -t "$tag" -f deploy/containers/Containerfile ${ignore[@]+"${ignore[@]}"} .
