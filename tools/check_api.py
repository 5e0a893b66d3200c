"""Checks a server against its API description: random valid and invalid requests, with played jobs.

    .venv-api/bin/python tools/check_api.py target/release/fled-fake

What is asked is the same every time. Every operation is asked about a finished job and its capture, but those that
would delete them.
"""

import argparse
import io
import json
import random
import struct
import subprocess
import sys
import tempfile
import time
import urllib.request
import uuid
import zlib
from pathlib import Path

# Random requests per operation, besides those at the limits of its parameters.
EXAMPLES = 15
# Seconds for everything; some 30 are used.
PATIENCE = 110
SIDE = 96
# A piece of an upload is bytes, whatever its media type.
HOOKS = """
import schemathesis

schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
"""
CONFIG = """
hooks = "hooks.py"
request-timeout = 20
continue-on-failure = true

# This phase would delete the objects of the others.
[phases.stateful]
enabled = false

[generation]
deterministic = true
max-examples = {examples}

# A value allowed by the schema may still be no camera, photograph or option.
[checks.positive_data_acceptance]
expected-statuses = ["2xx", "3xx", "404", "409", "422"]

# A 503 reports what the machine lacks, as intended.
[[operations]]
include-operation-id = "ready"
checks.not_a_server_error.enabled = false
checks.positive_data_acceptance.enabled = false

# Not every text is valid metadata, and no request knows the address of an upload.
[[operations]]
include-operation-id = ["create_upload", "show_upload", "continue_upload", "delete_upload"]
checks.positive_data_acceptance.expected-statuses = ["2xx", "400", "404", "409", "413", "422", "429", "507"]
checks.negative_data_rejection.expected-statuses = ["400", "404", "409", "412", "413", "415", "422", "429", "507"]
checks.missing_required_header.expected-statuses = ["400", "404", "412", "422"]

# The protocol gives the same options for every upload.
[[operations]]
include-operation-id = "one_upload_options"
checks.negative_data_rejection.enabled = false

"""
OF_JOB = [
    "show_job", "change_job", "cancel_job", "retry_job", "stream_events", "show_rounds", "show_log", "render_view",
    "render_camera", "list_artifacts", "download_artifact",
]


def photograph(seed):
    """A PNG of noise."""
    rows = b"".join(b"\0" + random.Random(f"{seed} {y}").randbytes(3 * SIDE) for y in range(SIDE))
    header = struct.pack(">IIBBBBB", SIDE, SIDE, 8, 2, 0, 0, 0)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def ask(url, body=None, kind="application/json"):
    """The JSON of an answer."""
    request = urllib.request.Request(url, body, {"Content-Type": kind})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.load(answer)


def finished_job(base):
    """A job that has succeeded."""
    boundary, body = uuid.uuid4().hex, io.BytesIO()
    for i in range(4):
        body.write(f'--{boundary}\r\nContent-Disposition: form-data; name="images"; filename="{i}.png"\r\n\r\n'.encode())
        body.write(photograph(i) + b"\r\n")
    body.write(f"--{boundary}--\r\n".encode())
    capture = ask(f"{base}/v1/captures", body.getvalue(), f"multipart/form-data; boundary={boundary}")
    order = {"capture_id": capture["id"], "preset": "preview", "options": {"adapter": "ok"}}
    job = ask(f"{base}/v1/jobs", json.dumps(order).encode())
    begun = time.monotonic()
    while job["state"] != "succeeded":
        if time.monotonic() - begun > 30:
            raise SystemExit(f"the played job does not end: {job}")
        time.sleep(0.1)
        job = ask(f"{base}/v1/jobs/{job['id']}")
    return job


def config(job):
    """schemathesis.toml: the checks, and the job and capture to request."""
    text = CONFIG.format(examples=EXAMPLES, job=job["id"])
    known = [(operation, job["id"]) for operation in OF_JOB] + [("show_capture", job["capture_id"])]
    # Random ids, so that nothing requested by the others is deleted.
    known += [(operation, str(uuid.uuid4())) for operation in ("delete_job", "delete_capture")]
    for operation, name in known:
        text += f'\n[[operations]]\ninclude-operation-id = "{operation}"\nparameters = {{ "path.id" = "{name}" }}\n'
    return text


def check(program, folder):
    """The exit status of the check."""
    address = folder / "address"
    with (folder / "log").open("w") as log:
        server = subprocess.Popen([program, "serve", folder / "data", address], stdout=log, stderr=log)
    try:
        begun = time.monotonic()
        while not (address.is_file() and ":" in address.read_text()):
            if server.poll() is not None or time.monotonic() - begun > 20:
                raise SystemExit(f"the server does not start: {(folder / 'log').read_text()}")
            time.sleep(0.05)
        base = f"http://{address.read_text()}"
        (folder / "hooks.py").write_text(HOOKS)
        (folder / "schemathesis.toml").write_text(config(finished_job(base)))
        schemathesis = Path(sys.executable).parent / "schemathesis"
        command = [schemathesis, "--config-file", folder / "schemathesis.toml", "run", f"{base}/openapi.yaml", "--url", base]
        outcome = subprocess.run(command, cwd=folder, timeout=PATIENCE)
        if server.poll() is not None:
            raise SystemExit(f"the server died: {(folder / 'log').read_text()[-4000:]}")
        return outcome.returncode
    finally:
        server.kill()
        server.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path)
    program = parser.parse_args().program.resolve()
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(check(program, Path(folder)))


if __name__ == "__main__":
    main()
