#!/usr/bin/env bash
# Foxglove's own client library for Node (@foxglove/ws-protocol, from npm) at the live view of a real server, by both
# subprotocols. GRASPD_BIN names the server's binary; without it one is built.
#
#   tests/peers/foxglove.sh [FOLDER FOR THE PACKAGES]
set -euo pipefail
cd "$(dirname "$0")/../.."
packages=${1:-${CARGO_TARGET_DIR:-target}/peers/foxglove}
command -v node >/dev/null 2>&1 && command -v npm >/dev/null 2>&1 || { echo "no node, or no npm"; exit "${PEER_IS_AWAY:-75}"; }
if [ ! -d "$packages/node_modules/protobufjs" ]; then
    mkdir -p "$packages"
    # Nothing of theirs is run when they are installed.
    timeout 240 npm install --prefix "$packages" --silent --no-audit --no-fund --ignore-scripts \
        @foxglove/ws-protocol@0.8.0 ws@8.18.3 protobufjs@7.5.4 || exit "${PEER_IS_AWAY:-75}"
fi
if [ -z "${GRASPD_BIN:-}" ]; then
    cargo build --quiet --workspace --bin graspd
    GRASPD_BIN="${CARGO_TARGET_DIR:-target}/debug/graspd"
fi
work=$(mktemp -d)
NO_COLOR=1 RUST_LOG=info "$GRASPD_BIN" serve --listen 127.0.0.1:0 --live 127.0.0.1:0 >"$work/log" 2>&1 &
server=$!
trap 'kill "$server" 2>/dev/null || true; rm -rf "$work"' EXIT
said() { sed -nE "s/.*$1.*/\\1/p" "$work/log" | head -1; }
for _ in $(seq 600); do
    [ -n "$(said 'local_addr=(127[^ ]*)')" ] && break
    sleep 0.1
done
address=$(said '(ws:\/\/127[^ ]*)')
planner=$(said 'local_addr=(127[^ ]*)')
for subprotocol in foxglove.websocket.v1 foxglove.sdk.v1; do
    rm -f "$work/answer.json"
    PEER_MODULES="$(readlink -f "$packages")" PEER_SUBPROTOCOL=$subprotocol \
        timeout 120 node tests/peers/foxglove.mjs "$address" "$work/answer.json" &
    viewer=$!
    # The first one looks before there is anything to see, the second one comes later.
    sleep 1
    "$GRASPD_BIN" plan cli/assets/demo_depth.png --intrinsics cli/assets/demo_frame.json --hand leap --json \
        --server "http://$planner" >"$work/part.json"
    mv "$work/part.json" "$work/answer.json"
    wait "$viewer"
    echo "$subprotocol: agreed"
done
