#!/bin/sh
# A controller with its plant, and what watches and retunes it: two processes on vcan0, at so many times real time.
#   sh examples/two_processes.sh [CONFIG [SPEED]]
set -e
config=${1:-examples/tank.toml} speed=${2:-10}
said=$(mktemp)
retuner device "$config" -i socketcan -c vcan0 --speed "$speed" 2>"$said" &
device=$!
trap 'kill $device 2>/dev/null; cat "$said" >&2; rm -f "$said"' EXIT
until grep -q "Ctrl-C ends it" "$said"; do # a model may take its time to begin
    kill -0 $device
    sleep 0.2
done
retuner run "$config" -i socketcan -c vcan0 --speed "$speed"
