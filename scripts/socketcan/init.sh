#!/bin/sh
# PID 1 inside user-mode Linux: brings up vcan0, runs $JOB/command.sh, writes its exit status to $JOB/status, powers off.
# The kernel hands JOB (a folder of the host, seen through hostfs) over as an environment variable.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin

finish() {
    sync
    echo "$1" >"$JOB/status"
    sync
    poweroff -f 2>/dev/null || halt -f -p
}

mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mount -t tmpfs tmpfs /dev/shm

modules=/usr/lib/uml/modules/$(uname -r)/kernel
for module in net/can/can net/can/can-raw net/can/can-bcm net/can/can-gw drivers/net/can/dev/can-dev drivers/net/can/vcan; do
    insmod "$modules/$module.ko" 2>>"$JOB/boot.log" || echo "insmod $module failed" >>"$JOB/boot.log"
done
ip link set lo up
{
    ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 && ip link set vcan0 txqueuelen 1000 && ip link set vcan0 up
} 2>>"$JOB/boot.log" || finish 76

sh "$JOB/command.sh" >"$JOB/stdout" 2>"$JOB/stderr" </dev/null
finish $?
