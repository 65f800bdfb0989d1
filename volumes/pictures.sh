#!/usr/bin/env bash
# Renders every scene in this folder into pictures/, as the READMEs show them.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --locked
for scene in volumes/*.toml; do
  name=$(basename "$scene" .toml)
  size=360x360
  case $name in head-* | brain-*) size=560x560 ;; apple-* | bunny-* | gyroid) size=400x400 ;; esac
  target/release/incise render "$scene" -o "volumes/pictures/$name.png" --size "$size" --backend cpu --quiet
done
