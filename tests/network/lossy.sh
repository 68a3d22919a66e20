#!/usr/bin/env bash
# Steps a second over a lossy network: server and client in network namespaces of their own, on this machine.
#   tests/network/lossy.sh [LINK...]        LINK is tcp or quic; both where none is named
#   LOSS=0.2   share of packets that are lost, each way
#   SECONDS_EACH=40
# Needs root, and iproute2, iptables and openssl. Build first: cargo build --release --workspace --bins
set -euo pipefail
cd "$(dirname "$0")/../.."
programs="${CARGO_TARGET_DIR:-target}/release"
loss="${LOSS:-0.2}" time="${SECONDS_EACH:-40}"
folder="$(mktemp -d)"
server=fiatlux-server client=fiatlux-client
cleanup() {
    for space in $server $client; do ip netns delete "$space" 2>/dev/null || true; done
    rm -rf "$folder"
}
trap cleanup EXIT

ip netns add $server
ip netns add $client
ip link add veth0 netns $server type veth peer name veth0 netns $client
number=1
for space in $server $client; do
    ip -n $space addr add 10.77.0.$number/24 dev veth0
    ip -n $space link set veth0 up
    ip -n $space link set lo up
    [ "$loss" = 0 ] || ip netns exec $space iptables -A INPUT -i veth0 -m statistic --mode random --probability "$loss" -j DROP
    number=$((number + 1))
done

# A certificate for the server, for the links that need one.
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1 -subj /CN=ca -keyout "$folder/ca.key" -out "$folder/ca.pem" 2>/dev/null
openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=server -keyout "$folder/key.pem" -out "$folder/request" 2>/dev/null
openssl x509 -req -in "$folder/request" -CA "$folder/ca.pem" -CAkey "$folder/ca.key" -days 1 -out "$folder/certificate.pem" \
    -extfile <(echo subjectAltName=IP:10.77.0.1) 2>/dev/null
tls() { echo "{ transport: { link: { tls: { $1 } } } }"; }
tls "listen_private_key: '$folder/key.pem', listen_certificate: '$folder/certificate.pem'" >"$folder/server.json5"
tls "root_ca_certificate: '$folder/ca.pem'" >"$folder/client.json5"

links="${*:-tcp quic}"
for link in $links; do
    ip netns exec $server "$programs/sim-server" --name lossy -c "$folder/server.json5" -l "$link/10.77.0.1:7447" >"$folder/server.log" 2>&1 &
    pid=$!
    sleep 1
    ip netns exec $client timeout -s INT "$time" "$programs/policy-client" run --json --policy stand --task S05 \
        -c "$folder/client.json5" -e "$link/10.77.0.1:7447" >"$folder/report.json" 2>"$folder/client.log" || true
    kill -INT $pid
    wait $pid || true
    rate="$(tr '\r' '\n' <"$folder/client.log" | grep -o '[0-9.]* steps/s' | tail -1 || true)"
    echo "$link, $loss lost each way: ${rate:-not connected: $(tail -1 "$folder/client.log")}"
done
