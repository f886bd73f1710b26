#!/usr/bin/env bash
# Independent clients against the emulated Universal Robots controller, and an independent implementation against our
# kinematics. Makes its own Python environment (pinned versions) under target/peers/. Ports are those of a real
# controller, on a loopback address of its own: ADDRESS, 127.0.0.9 if not given.
set -euo pipefail
cd "$(dirname "$0")/../.."
address="${1:-127.0.0.9}"
target="${CARGO_TARGET_DIR:-target}"
venv="$target/peers/ur"
if [ ! -x "$venv/bin/python" ]; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check \
        ur_rtde==1.6.5 universal-robots-clients==0.4.0 ur-analytic-ik==0.1.0.post3
fi
cargo build --quiet --workspace --example ur_emulator
"$venv/bin/python" tests/peers/ur_kinematics.py | diff - adapters/ur/tests/golden/kinematics.tsv
echo "kinematics: the committed table is what ur-analytic-ik computes"
"$target/debug/examples/ur_emulator" --address "$address" &
emulator=$!
trap 'kill "$emulator" 2>/dev/null || true' EXIT
for _ in $(seq 50); do
    if (exec 3<>"/dev/tcp/$address/30004") 2>/dev/null; then break; fi
    sleep 0.1
done
# Not the clients themselves decide how long they may hang.
timeout 120 "$venv/bin/python" tests/peers/ur_peers.py "$address"
