"""A client in Python, from proto/PROTOCOL.md alone: it opens a session, sends zeros, and prints how the episode ends.

    pip install -r docs/client.requirements.txt
    mkdir -p build
    python -m grpc_tools.protoc -I proto/proto --python_out=build fiatlux/v3/{session,observation,room}.proto
    PYTHONPATH=build python docs/client.py tcp/127.0.0.1:7447 SERVER S07 [ed25519:KEY]
"""

import base64
import hashlib
import hmac
import os
import queue
import struct
import sys

import zenoh
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from fiatlux.v3 import observation_pb2, session_pb2


def sha256(data):
    return hashlib.sha256(data).digest()

def ask(session, key, payload, attachment=None):
    everyone = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
    return session.get(key, payload=payload, attachment=attachment, timeout=60.0, **everyone)

class Channel:
    """Numbers and seals what is sent, and takes what the server has sealed."""

    def __init__(self, secret, transcript):
        def key(info):
            return HKDF(hashes.SHA256(), 32, salt=transcript, info=info).derive(secret)

        self.sends, self.receives = key(b"client to server"), key(b"server to client")
        self.next, self.taken = 0, set()

    def seal(self, label, payload):
        number = struct.pack("<Q", self.next)
        self.next += 1
        return number + hmac.digest(self.sends, label + b"\0" + number + payload, "sha256")[:16]

    def is_sealed(self, label, payload, attachment, asked=b""):
        attachment = bytes(attachment or b"")
        number, code = attachment[:8], attachment[8:]
        expected = hmac.digest(self.receives, label + b"\0" + number + asked + payload, "sha256")[:16]
        if len(attachment) != 24 or not hmac.compare_digest(code, expected):
            return False
        if not asked:
            number = struct.unpack("<Q", number)[0]
            newest = max(self.taken, default=0)
            if number in self.taken or number + 64 <= newest:
                return False
            self.taken = {old for old in self.taken if old + 64 > number} | {number}
        return True

def open_session(session, endpoint, server, task, known):
    private = X25519PrivateKey.generate()
    request = session_pb2.OpenRequest(task=task, policy="python", protocol=session_pb2.Version(major=3, minor=4))
    request.hello.key = private.public_key().public_bytes_raw()
    request.hello.random = os.urandom(32)
    request.hello.peer = str(session.zid())
    payload = request.SerializeToString(deterministic=True)
    for reply in ask(session, f"fiatlux/v3/{server}/open", payload):
        if reply.ok is None:
            continue
        opened = session_pb2.OpenReply.FromString(bytes(reply.ok.payload))
        said, welcome = getattr(opened, opened.WhichOneof("reply")), opened.welcome
        name = getattr(said, "session", "")
        start = b"fiatlux handshake 3.4\0" + request.hello.key + welcome.key + request.hello.random
        content = sha256(said.SerializeToString(deterministic=True))
        transcript = sha256(start + f"{server}\0{name}\0".encode() + sha256(payload) + content)
        if known not in (None, welcome.identity):
            continue
        try:
            signed = b"fiatlux handshake 3.4 signature\0" + transcript
            Ed25519PublicKey.from_public_bytes(welcome.identity).verify(welcome.signature, signed)
        except Exception:
            continue
        if not name:
            sys.exit(f"refused: {said.message}")
        return said, Channel(private.exchange(X25519PublicKey.from_public_bytes(welcome.key)), transcript)
    sys.exit(f"no server '{server}'{' with that key' if known else ''} answers at {endpoint}; `policy-client list` shows names")

def main(endpoint, server, task, known=None):
    config = zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}')
    known = known and base64.b64decode(known.removeprefix("ed25519:"))
    with zenoh.open(config) as session:
        info, channel = open_session(session, endpoint, server, task, known)
        keys = f"fiatlux/v3/{server}/s/{info.session}"
        heard = queue.Queue()
        session.liveliness().declare_token(f"{keys}/client")
        session.declare_subscriber(f"{keys}/observation", heard.put)
        def query(label, payload):
            attachment = channel.seal(label, payload)
            for reply in ask(session, f"{keys}/{label.decode()}", payload, attachment):
                body = bytes(reply.ok.payload) if reply.ok else b""
                if reply.ok and channel.is_sealed(b"reply to " + label, body, reply.ok.attachment, attachment[:8]):
                    return body
            sys.exit(f"{label.decode()} is not answered")

        reset = session_pb2.ResetReply.FromString(query(b"reset", session_pb2.ResetRequest().SerializeToString()))
        step, end = reset.observation.step, None
        while end is None:
            action = session_pb2.Action(step=step, action=[0.0] * len(info.joints)).SerializeToString()
            session.put(f"{keys}/action", action, attachment=channel.seal(b"action", action))
            sample = heard.get(timeout=10)
            if channel.is_sealed(b"observation", bytes(sample.payload), sample.attachment):
                seen = observation_pb2.Observation.FromString(bytes(sample.payload))
                step, end = seen.step, seen.end if seen.HasField("end") else None
        print(f"{end.cause} after {end.steps} steps, digest {end.digest}")
        query(b"close", b"")

if __name__ == "__main__":
    main(*sys.argv[1:]) if len(sys.argv) in (4, 5) else sys.exit(__doc__)
