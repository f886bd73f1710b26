#!/usr/bin/env bash
# Independent client software against the emulated Dynamixel bus: the motor manufacturer's SDK and rustypot.
#
#   tests/peers/dynamixel.sh [FOLDER FOR THE PYTHON ENVIRONMENT]
set -euo pipefail
cd "$(dirname "$0")/../.."
venv=${1:-${CARGO_TARGET_DIR:-target}/peers-dynamixel}
if ! [ -x "$venv/bin/python" ] || ! "$venv/bin/python" -c 'import dynamixel_sdk, rustypot' 2>/dev/null; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check dynamixel-sdk==4.1.0 rustypot==1.13.1
fi
cargo build --quiet --workspace --example dynamixel_bus
emulator=${CARGO_TARGET_DIR:-target}/debug/examples/dynamixel_bus
exec timeout 120 "$venv/bin/python" tests/peers/dynamixel.py "$emulator"
