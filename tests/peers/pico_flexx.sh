#!/usr/bin/env bash
# A ROS 2 driver as it stands in a lab, without a ROS installation: rclpy publishes what the driver of the pico flexx does, an
# independent rosbridge server passes it on, our camera reads it. All three packages come from PyPI.
#
#   tests/peers/pico_flexx.sh [FOLDER FOR THE PYTHON ENVIRONMENT]
#
# About 300 MB. Where it may, it runs in a network of its own, so that DDS does not speak to the rest of the building.
set -euo pipefail
cd "$(dirname "$0")/../.."
venv=${1:-${CARGO_TARGET_DIR:-target}/peers-pico-flexx}
if ! [ -x "$venv/bin/python" ] || ! "$venv/bin/python" -c 'import rclpy, sensor_msgs, rosbridge_server_rs' 2>/dev/null; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    # Wheels, but for what is pure Python: without one for this Python and machine there is nothing to build from.
    timeout 240 "$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: --no-binary empy \
        --retries 2 --timeout 20 rosbridge-server-rs==0.1.6 ros-kilted-rclpy==9.1.2 ros-kilted-std-msgs==5.5.1 \
        ros-kilted-geometry-msgs==5.5.1 ros-kilted-sensor-msgs==5.5.1 ros-rmw-fastrtps-cpp==9.3.3 \
        || exit "${PEER_IS_AWAY:-75}"
fi
cargo build --quiet --workspace --example watch
watch=$(readlink -f "${CARGO_TARGET_DIR:-target}/debug/examples/watch")
apart=()
if unshare -n true 2>/dev/null; then
    apart=(unshare -n)
fi
# The last words of a command line run in that network.
timeout 300 "${apart[@]}" bash -c '
    if [ "$1" = apart ]; then
        ip link set lo up
        ip link set lo multicast on
        ip route add 224.0.0.0/4 dev lo
    fi
    exec "$2" tests/peers/pico_flexx.py "$3"
' run "${apart:+apart}" "$venv/bin/python" "$watch"
