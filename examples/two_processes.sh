#!/bin/sh
# A controller with its plant, and what watches and retunes it: two processes on one bus, at so many times real time.
#   sh examples/two_processes.sh [CONFIG [SPEED [INTERFACE CHANNEL]]]    without vcan: ... 10 udp_multicast 239.74.163.2
set -e
config=${1:-examples/tank.toml} speed=${2:-10} interface=${3:-socketcan} channel=${4:-vcan0}
said=$(mktemp)
retuner device "$config" -i "$interface" -c "$channel" --speed "$speed" 2>"$said" &
device=$!
trap 'kill $device 2>/dev/null || true; cat "$said" >&2; rm -f "$said"' EXIT
until grep -q "Ctrl-C ends it" "$said"; do # a model may take its time to begin
    kill -0 $device
    sleep 0.2
done
retuner run "$config" -i "$interface" -c "$channel" --speed "$speed"
