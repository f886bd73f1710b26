#!/usr/bin/env bash
# Independent software on both sides of Robotiq's protocols: client libraries against the emulated grippers, and an
# independent Modbus slave against our master.
#
#   tests/peers/robotiq.sh [FOLDER FOR THE PYTHON ENVIRONMENT]
set -euo pipefail
cd "$(dirname "$0")/../.."
venv=${1:-${CARGO_TARGET_DIR:-target}/peers-robotiq}
if ! [ -x "$venv/bin/python" ] || ! "$venv/bin/python" -c 'import pyrobotiqgripper, pyrobotiqur, minimalmodbus' 2>/dev/null; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check \
        pyrobotiqgripper==3.3.14 pyrobotiqur==0.2.2 minimalmodbus==2.1.1 pymodbus==3.16.1
fi
examples=${CARGO_TARGET_DIR:-target}/debug/examples
cargo build --quiet --workspace --example robotiq_gripper
timeout 180 "$venv/bin/python" tests/peers/robotiq.py "$examples/robotiq_gripper"
timeout 240 "$venv/bin/python" tests/peers/robotiq_three_finger.py "$examples/robotiq_gripper"

# Our master against pymodbus as the slave.
cargo build --quiet --workspace --example grip --example three_finger
for model in 2f 3f; do
    for kind in rtu tcp; do
        coproc slave { exec "$venv/bin/python" tests/peers/modbus_slave.py "$kind" "$model"; }
        pid=$slave_PID
        trap 'kill "$pid" 2>/dev/null || true' EXIT
        read -r place <&"${slave[0]}"
        sleep 1
        echo "pymodbus 3.16.1 as slave, $model, $kind"
        case "$model" in
            2f) timeout 60 "$examples/grip" "$place" 1000 ;;
            3f) timeout 60 "$examples/three_finger" "$place" ;;
        esac
        kill "$pid"
        wait "$pid" 2>/dev/null || true
    done
done
echo "all ok, both ways"
