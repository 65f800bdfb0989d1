#!/usr/bin/env bash
# Prints [DS07] table 1: the time of one picture of each mesh, continuously deformed, and cut without
# and with skipping of the space that the cut emptied.
#
#     volumes/table-1.sh [FOLDER]
#
# Without FOLDER it measures bunny.obj only; FOLDER holds the meshes that meshes.sh names.
# Needs jq. SIZE, BACKEND and INCISE change the picture's size, the backend and the program.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
size=${SIZE:-256x256}
backend=${BACKEND:-cpu}
incise=${INCISE:-$here/../target/release/incise}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
measure() { # mesh turn skipping deformation
  printf 'incise = 1\n[[mesh]]\npath = "%s"\nsize = 100.0\nrotate = %s\nresolution = 192\nmodel = "solid"\n[surface]\nsteps = "uniform"\ncut_skipping = %s\n[camera]\nview = "25,15"\n[render]\nmode = "surface"\n[[deformation]]\n%b\n' \
    "$1" "$2" "$3" "$4" > "$work/scene.toml"
  "$incise" render "$work/scene.toml" -o "$work/picture.png" --size "$size" --backend "$backend" --quiet --stats - |
    jq -r '"\(.milliseconds.render | round) ms, \((.samples.taken / 1e6 * 100 | round) / 100) M samples"'
}
row() { # name mesh turn
  local twist='kind = "twist"\nangle = 50.0'
  local wedge='kind = "wedge"\nangle = 80.0\nrotate = [0.0, 0.0, -60.0]\nsize = [160.0, 160.0, 160.0]\ncenter = [2.0, 4.0, 0.0]'
  local triangles
  triangles=$("$incise" info --json "$2" | jq .triangles)
  echo "| $1 | $triangles | $(measure "$2" "$3" true "$twist") | $(measure "$2" "$3" false "$wedge") | $(measure "$2" "$3" true "$wedge") |"
}
echo "| mesh | triangles | continuous | cut | cut, space skipped |"
echo "|---|---|---|---|---|"
if [ $# -eq 0 ]; then
  row bunny "$here/bunny.obj" '[90, 0, 0]'
else
  folder=$(realpath "$1")
  row hand "$folder/hand.off" '[0, 0, 0]'
  row bunny "$folder/bunny00.off" '[90, 0, 0]'
  row armadillo "$folder/armadillo.off" '[90, 0, 180]'
  row dragon "$folder/dragon_vrip_res2.ply.gz" '[90, 0, 0]'
fi
