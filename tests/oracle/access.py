"""A Python client (eclipse-zenoh) at a router with access control: what a policy may do works, the rest is without effect.

`tests/tests/it/access.rs` runs it. By hand, next to the programs of one installation, with `fiatlux`, `sim-server` in PATH:

    python3 -m venv venv && venv/bin/pip install eclipse-zenoh==1.10.2
    fiatlux keys --out keys --name lab
    fiatlux router -c keys/router.json5 &
    sim-server -c keys/server.json5 --name lab &
    venv/bin/python tests/oracle/access.py keys lab

It prints a line for each check and ends with 1 where one fails. `--auth password` makes keys for the same checks without TLS.
It printed, with either:

    ok    a policy finds the server
    ok    a policy is answered by the server
    ok    an answer comes to a forged open request
    ok    a policy hears nothing on **
    ok    a policy hears no rows
    ok    no query comes to a policy's queryable
    ok    a policy passes for no server
    ok    without a certificate or password nobody connects
"""

import json
import sys
import time

import zenoh

ROOT = "fiatlux/v3"
REMOTE = zenoh.Locality.REMOTE


def relaxed(path):
    """The config of a part, without the rules that it would hold itself to."""
    config = zenoh.Config.from_file(path)
    config.insert_json5("access_control", '{enabled: false, default_permission: "allow"}')
    config.insert_json5("connect/timeout_ms", "3000")
    config.insert_json5("connect/exit_on_failure", "true")
    return config


def alive(session):
    replies = session.liveliness().get(f"{ROOT}/*/alive", timeout=2.0)
    return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok)


def main(folder, server):
    zenoh.init_log_from_env_or("off")
    failed = []

    def check(what, is_so):
        print("ok   " if is_so else "FAIL ", what)
        if not is_so:
            failed.append(what)

    heard, rows, queries = [], [], []
    with zenoh.open(relaxed(f"{folder}/policy.json5")) as policy:
        everything = policy.declare_subscriber(
            "**", lambda sample: heard.append(str(sample.key_expr)), allowed_origin=REMOTE
        )
        truth = policy.declare_subscriber(f"{ROOT}/*/s/*/truth/row", rows.append, allowed_origin=REMOTE)
        forged = policy.declare_queryable(
            f"{ROOT}/{server}/describe", queries.append, complete=True, allowed_origin=REMOTE
        )
        token = policy.liveliness().declare_token(f"{ROOT}/forged/alive")
        time.sleep(1.0)
        check("a policy finds the server", f"{ROOT}/{server}/alive" in alive(policy))
        with zenoh.open(relaxed(f"{folder}/recorder.json5")) as other:
            answers = [reply for reply in other.get(f"{ROOT}/{server}/describe", timeout=3.0) if reply.ok]
            check(
                "a policy is answered by the server", len(answers) == 1 and len(answers[0].ok.payload.to_bytes()) > 10
            )
            # Bytes that are not a request: the server refuses them, and its answer comes through.
            answers = [reply for reply in policy.get(f"{ROOT}/{server}/open", payload=b"\xff", timeout=5.0)]
            check("an answer comes to a forged open request", len(answers) == 1)
            other.put(f"{ROOT}/{server}/s/x/action", b"\x00")
            other.put(f"{ROOT}/{server}/s/x/truth/ack", b"\x00")
            policy.put(f"{ROOT}/{server}/s/x/truth/row", b"\x00")
            time.sleep(1.0)
            check("a policy hears nothing on **", not heard)
            check("a policy hears no rows", not rows)
            check("no query comes to a policy's queryable", not queries)
            check("a policy passes for no server", alive(other) == [f"{ROOT}/{server}/alive"])
        for declared in (everything, truth, forged, token):
            declared.undeclare()

    endpoints = json.loads(zenoh.Config.from_file(f"{folder}/policy.json5").get_json("connect/endpoints"))
    stranger = zenoh.Config()
    stranger.insert_json5("mode", '"client"')
    stranger.insert_json5("scouting/multicast/enabled", "false")
    stranger.insert_json5("connect/endpoints", json.dumps(endpoints))
    stranger.insert_json5("connect/timeout_ms", "2000")
    stranger.insert_json5("connect/exit_on_failure", "true")
    try:
        zenoh.open(stranger).close()
        connected = True
    except zenoh.ZError:
        connected = False
    check("without a certificate or password nobody connects", not connected)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
