#!/usr/bin/env bash
# The ROS 2 bridge against real ROS 2: rclpy with Fast DDS publishes what a camera does, asks for grasps as users do, and checks what
# it gets. Packages from PyPI; no ROS installation.
#
#   tests/peers/ros2.sh [FOLDER FOR THE PYTHON ENVIRONMENT]
#
# About 300 MB. It runs in a network of its own, so that DDS does not speak to the rest of the building; where none may be made it is
# skipped, as a peer that is not to be had.
set -euo pipefail
cd "$(dirname "$0")/../.."
venv=${1:-${CARGO_TARGET_DIR:-target}/peers-ros2}
command -v ip >/dev/null || { echo "no ip (iproute2)"; exit "${PEER_IS_AWAY:-75}"; }
if unshare -n true 2>/dev/null; then
    apart=(unshare -n)
elif unshare -rn true 2>/dev/null; then
    apart=(unshare -rn)
else
    echo "no network namespaces here (unshare -n)"
    exit "${PEER_IS_AWAY:-75}"
fi
messages='rclpy, sensor_msgs, visualization_msgs, trajectory_msgs, diagnostic_msgs, std_srvs'
if ! [ -x "$venv/bin/python" ] || ! "$venv/bin/python" -c "import $messages" 2>/dev/null; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    # Wheels, but for what is pure Python: without one for this Python and machine there is nothing to build from.
    timeout 400 "$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: --no-binary empy \
        --retries 2 --timeout 20 ros-kilted-rclpy==9.1.2 ros-kilted-std-msgs==5.5.1 ros-kilted-std-srvs==5.5.1 \
        ros-kilted-geometry-msgs==5.5.1 ros-kilted-sensor-msgs==5.5.1 ros-kilted-trajectory-msgs==5.5.1 \
        ros-kilted-visualization-msgs==5.5.1 ros-kilted-diagnostic-msgs==5.5.1 ros-rmw-fastrtps-cpp==9.3.3 \
        || exit "${PEER_IS_AWAY:-75}"
fi
# GRASPD_BIN names a server's binary; without it one is built.
graspd=${GRASPD_BIN:-${CARGO_TARGET_DIR:-target}/debug/graspd}
[ -n "${GRASPD_BIN:-}" ] || cargo build --quiet --workspace --bin graspd
# What was built with the named program lies beside it.
programs=$(dirname "$graspd")
[ -n "${GRASPD_BIN:-}" ] && [ -x "$programs/graspd-ros2" ] || cargo build --quiet --workspace --bin graspd-ros2
# The last words of a command line run in that network.
timeout 900 "${apart[@]}" bash -c '
    ip link set lo up
    ip link set lo multicast on
    ip route add 224.0.0.0/4 dev lo
    exec "$1" tests/peers/ros2.py "$2" "$3"
' run "$venv/bin/python" "$graspd" "$programs/graspd-ros2"
