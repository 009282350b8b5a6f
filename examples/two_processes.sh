#!/bin/sh
# A controller with its plant, and what watches and retunes it: two processes on vcan0, at so many times real time.
#   sh examples/two_processes.sh [CONFIG [SPEED]]
set -e
config=${1:-examples/tank.toml} speed=${2:-10}
retuner device "$config" -i socketcan -c vcan0 --speed "$speed" &
trap 'kill $!' EXIT
retuner run "$config" -i socketcan -c vcan0 --speed "$speed"
