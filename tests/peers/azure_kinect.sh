#!/usr/bin/env bash
# The manufacturer's own library (from the package pyk4a-bundle) against our recordings, calibration and lens: what its
# recorder writes is read here, what is written here is read by it, pixels become the same points.
#
#   tests/peers/azure_kinect.sh [FOLDER FOR THE PYTHON ENVIRONMENT] [RECORDING OF A REAL DEVICE]
#
# Its point-cloud engine wants OpenGL and a display: with xvfb-run that part runs too, else it says that it was left out.
set -euo pipefail
cd "$(dirname "$0")/../.."
venv=${1:-${CARGO_TARGET_DIR:-target}/peers-azure-kinect}
if ! [ -x "$venv/bin/python" ] || ! "$venv/bin/python" -c 'import pyk4a, numpy' 2>/dev/null; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    # Only wheels: building from source would want the manufacturer's headers.
    timeout 180 "$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: --retries 2 --timeout 20 \
        pyk4a-bundle==1.5.0 numpy==1.26.4 || exit "${PEER_IS_AWAY:-75}"
fi
cargo build --quiet --workspace --example peer
peer=${CARGO_TARGET_DIR:-target}/debug/examples/peer
display=()
if command -v xvfb-run >/dev/null 2>&1; then
    display=(xvfb-run -a)
fi
timeout 300 "${display[@]}" "$venv/bin/python" tests/peers/azure_kinect.py "$peer" ${2:+"$2"}
