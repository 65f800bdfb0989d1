#!/usr/bin/env bash
# Renders every scene in this folder, and the variants that PAPERS.md shows, into pictures/.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --locked
picture() { # name scene option...
  local name=$1 scene=$2
  shift 2
  target/release/incise render "volumes/$scene.toml" -o "volumes/pictures/$name.png" --size 800x800 --backend cpu --quiet "$@"
}
for scene in volumes/*.toml; do
  name=$(basename "$scene" .toml)
  picture "$name" "$name"
done
picture narrow-pull narrow-pull-jacobian --zoom 0.6
picture spline-pulls-cut spline-pulls --deform half-space:center=0,-26,0,rotate=90,0,0
picture tapered-block-side tapered-block --camera 50,30 --zoom 1.35 --projection orthographic
n=1
for center in 20.3,26.7,50.0 11.0,20.0,46.7 3.2,14.4,44.0 -3.9,9.4,41.6; do
  picture bunny-ear-twist-$n bunny-ear --deform twist:center=$center,size=34,34,44,rotate=0,74,36,angle=300,falloff=0.3
  n=$((n + 1))
done
n=1
for x in 50 42 34 28; do
  picture bunny-peel-$n bunny-ear --camera 35,30 --zoom 1.1 --deform peel:center=$x,0,18,size=100,92,50,depth=18,radius=21.6
  n=$((n + 1))
done
