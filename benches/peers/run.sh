#!/bin/sh
# Measures incise and its peers alternately on the same work: sets up Python and the worker, then
# runs run.py with the arguments given.
#   --python PATH (first) takes that interpreter instead of making an environment under
#   target/peers/venv.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
cd "$root"

if [ "${1:-}" = "--python" ]; then
    python=$2
    shift 2
else
    venv=$root/target/peers/venv
    python=$venv/bin/python
    [ -x "$python" ] || python3 -m venv "$venv"
    "$python" -m pip install --quiet --requirement "$here/requirements.txt"
fi

built=$(cargo bench --no-run --bench peers --message-format=json-render-diagnostics)
worker=$(echo "$built" | sed -n 's/.*"executable":"\([^"]*peers-[^"]*\)".*/\1/p' | tail -n 1)

exec "$python" "$here/run.py" --worker "$worker" "$@"
