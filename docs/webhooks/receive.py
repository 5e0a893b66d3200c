#!/usr/bin/env python3
"""Receives fled's webhooks: `FLED_WEBHOOK_SECRET=whsec_... receive.py PORT` prints each that is genuine.

Needs only Python. Copy `genuine` into your own program.
"""

import base64
import hashlib
import hmac
import json
import os
import sys
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

# Tolerance of the timestamp, seconds; a request outside it may be a replay.
TOLERANCE = 300


def genuine(secret: str, headers, body: bytes) -> bool:
    """Whether `body` was signed with the secret (`whsec_...`) according to these headers, just now."""
    message, sent = headers.get("webhook-id", ""), headers.get("webhook-timestamp", "")
    if not sent.isdecimal() or abs(time.time() - int(sent)) > TOLERANCE:
        return False
    key = base64.b64decode(secret.removeprefix("whsec_"))
    signed = f"{message}.{sent}.".encode() + body
    wanted = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    signatures = headers.get("webhook-signature", "").encode().split()
    return any(hmac.compare_digest(f"v1,{wanted}".encode(), signature) for signature in signatures)


class Receiver(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("content-length", 0)))
        if not genuine(os.environ["FLED_WEBHOOK_SECRET"], self.headers, body):
            self.send_error(401)
            return
        # The same webhook-id may arrive twice: keep a list of them if an action must happen once.
        event = json.loads(body)
        print(self.headers["webhook-id"], event["type"], json.dumps(event["data"]), flush=True)
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_) -> None:
        """What is printed are the webhooks."""


if __name__ == "__main__":
    HTTPServer(("127.0.0.1", int(sys.argv[1])), Receiver).serve_forever()
