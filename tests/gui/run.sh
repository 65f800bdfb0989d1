#!/usr/bin/env bash
# The real window on a display of its own, used with a real mouse: it opens, a drag turns the head,
# a peel is dropped and opened, renderers are compared, the session is saved. Screenshots go into
# FOLDER, if it is given.
#
#   tests/gui/run.sh PROGRAM [FOLDER]
#
# Needs Xvfb, xdotool and ImageMagick.
set -euo pipefail
program=$(realpath "$1")
photos=${2:-}
root=$(realpath "$(dirname "$0")/../..")
work=$(mktemp -d)
export INCISE_HOME=$work/home XDG_RUNTIME_DIR=$work
app='' server=''
cleanup() {
  [ -n "$app" ] && kill "$app" 2>/dev/null || true
  [ -n "$server" ] && kill "$server" 2>/dev/null || true
  rm -rf "$work"
}
trap cleanup EXIT

fail() {
  echo "tests/gui: $1" >&2
  [ -s "$work/log" ] && tail -n 5 "$work/log" >&2
  exit 1
}

# A free display number.
for n in $(seq 80 120); do
  [ -e "/tmp/.X11-unix/X$n" ] && continue
  # Without -noreset the display resets whenever its last client leaves, and the next client may
  # connect during the reset.
  Xvfb ":$n" -screen 0 1280x800x24 -noreset >/dev/null 2>&1 &
  server=$!
  export DISPLAY=:$n
  break
done
for _ in $(seq 50); do xdotool getmouselocation >/dev/null 2>&1 && break; sleep 0.1; done

photo() { # those called workstation... are for showing
  import -window root "$work/$1.png"
  case $photos/$1 in
    ?*/workstation*) mkdir -p "$photos" && convert "$work/$1.png" -strip -define png:compression-level=9 "$photos/$1.png" ;;
  esac
}
# Pixels of a part of the window that differ between two photographs.
differ() {
  local part=$3
  convert "$work/$1.png" -crop "$part" +repage "$work/a.png"
  convert "$work/$2.png" -crop "$part" +repage "$work/b.png"
  compare -metric AE -fuzz 3% "$work/a.png" "$work/b.png" null: 2>&1 | cut -d' ' -f1 || true
}
still() { # until two photographs in a row are alike
  for _ in $(seq 60); do
    import -window root "$work/still-a.png"; sleep 1; import -window root "$work/still-b.png"
    [ "$(compare -metric AE "$work/still-a.png" "$work/still-b.png" null: 2>&1 | cut -d' ' -f1)" = 0 ] && return
  done
  fail 'the window does not come to rest'
}
drag() { # from x y to x y
  xdotool mousemove "$1" "$2" mousedown 1
  for i in 1 2 3 4 5 6 7 8; do xdotool mousemove $(($1 + ($3 - $1) * i / 8)) $(($2 + ($4 - $2) * i / 8)); sleep 0.06; done
  xdotool mouseup 1
}
key() { xdotool windowfocus "$window"; sleep 0.2; xdotool key "$1"; sleep 0.4; }
start() {
  local begin end
  begin=$(date +%s%N)
  "$program" "$@" >"$work/log" 2>&1 &
  app=$!
  for _ in $(seq 200); do
    window=$(xdotool search --name incise 2>/dev/null | head -n 1) && [ -n "$window" ] && break
    kill -0 "$app" 2>/dev/null || fail 'the program ended'
    sleep 0.05
  done
  [ -n "$window" ] || fail 'no window'
  end=$(date +%s%N)
  echo "window after $(((end - begin) / 1000000)) ms"
}

view=820x440+195+62

start
still
photo workstation-empty
kill "$app"; wait "$app" 2>/dev/null || true

printf 'incise = 1\n[volume]\npath = "%s/volumes/colin27-head-t1.nii.gz"\n[camera]\nview = "35,30"\n' "$root" >"$work/head.toml"
start "$work/head.toml"
still
photo open

# A drag turns the head: something else is shown while the button is still held.
xdotool mousemove 750 400 mousedown 1
for i in 1 2 3 4 5 6 7 8 9 10; do xdotool mousemove $((750 - 8 * i)) 400; sleep 0.08; done
sleep 0.5
photo turning
xdotool mouseup 1
moved=$(differ open turning "$view")
echo "turning: $moved pixels changed during the drag"
[ "$moved" -gt 20000 ] || fail 'the picture did not change during the drag'
still
photo turned

# A peel onto the scalp, and its slider to open it.
key p
xdotool mousemove 600 190; sleep 0.5; xdotool click 1
still
photo dropped
peeled=$(differ turned dropped "$view")
echo "peel: $peeled pixels changed"
[ "$peeled" -gt 3000 ] || fail 'no peel was dropped'
for _ in 1 2 3 4 5 6 7; do key bracketright; done
xdotool mousemove 60 400
still
photo workstation
opened=$(differ dropped workstation "$view")
echo "opened: $opened pixels changed"
[ "$opened" -gt 1500 ] || fail 'the peel did not open'

# Undo, and redo.
key ctrl+z; still; photo undone
[ "$(differ undone workstation "$view")" -gt 50 ] || fail 'undo changed nothing'
key ctrl+shift+z; still; photo redone
same=$(differ redone workstation "$view")
[ "$same" -lt 2000 ] || fail "redo gave another picture ($same pixels)"

# Saved, and whole.
key ctrl+s
sleep 1
grep -q 'kind = "peel"' "$work/head.toml" || fail 'the session was not saved'
sleep 5 # the message of it goes away

key ctrl+k; sleep 0.5; xdotool type lay; sleep 1
photo workstation-commands
key Escape
xdotool mousemove 905 16 click 1; sleep 0.5
still
photo workstation-kinds
key Escape; key Escape
key shift+v
sleep 6
still
photo workstation-compare
kill -0 "$app" || fail 'the program ended'
echo 'tests/gui: all is well'
