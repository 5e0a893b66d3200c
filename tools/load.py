"""Measures the service's response times while a job trains: a table for docs/results.md.

    tools/load.py CAPTURE

Starts `fled serve` on a free port of this machine, and asks it for one job and for the list of jobs, again and again:
while it does nothing, while a job of CAPTURE trains, while event streams are read besides, and while photographs are
uploaded besides. Photographs are those of CAPTURE, made large by what decoders do not read.
"""

import argparse
import contextlib
import http.client
import json
import os
import selectors
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
PHOTOGRAPHS = {".jpg", ".jpeg", ".png"}
# Pause between two requests, seconds, like a user with many windows.
PAUSE = 0.02
# Jobs that outlast the measurements: a real one that trains, and a played one.
ORDER = {"preset": "preview", "options": {"rounds": 1, "steps": 100_000}}
PLAYED = {"preset": "preview", "options": {"adapter": "slow:2500"}}
PATIENCE = 600
MIB = 1 << 20
BOUNDARY = b"----fled-load"


class Service:
    """`fled serve`, from its start to its end."""

    def __init__(self, program, folder):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = ("127.0.0.1", probe.getsockname()[1])
        listen = "%s:%d" % self.address
        self.played = program.name == "fled-fake"
        if self.played:
            command = [program, "serve", folder / "data", folder / "address"]
        else:
            command = [program, "serve", "--data", folder / "data", "--listen", listen, "--workers", "1"]
        own = {"FLED_FAKE_LISTEN": listen, "FLED_FAKE_UPLOAD_BYTES": str(8 << 30)}
        with (folder / "server.log").open("wb") as log:
            self.process = subprocess.Popen(
                command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=os.environ | own)

    def __enter__(self):
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and self.process.poll() is None:
            with contextlib.suppress(ConnectionError):
                self.json("GET", "/livez", expect=200)
                return self
            time.sleep(0.1)
        raise SystemExit("the service did not start")

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()

    def connection(self):
        return http.client.HTTPConnection(*self.address, timeout=PATIENCE)

    def json(self, method, path, body=None, expect=200):
        connection = self.connection()
        headers = {"content-type": "application/json"} if body is not None else {}
        connection.request(method, path, json.dumps(body) if body is not None else None, headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        if answer.status != expect:
            raise SystemExit(f"{method} {path}: {answer.status} {content.decode()}")
        return json.loads(content) if content.startswith((b"{", b"[")) else content

    def memory(self):
        """Peak memory of the server's own process, bytes."""
        return memory_of(self.process.pid, "VmHWM")


def memory_of(pid, field):
    """A line of /proc/PID/status, bytes; 0 when the process is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(field + ":")), 0)


def children(pid):
    """The server's child processes."""
    with contextlib.suppress(OSError):
        return [int(child) for task in Path(f"/proc/{pid}/task").iterdir()
                for child in (task / "children").read_text().split()]
    return []


def share(values, part):
    """The quantile: the least value that this share of the values does not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))]


class Asking(threading.Thread):
    """Requests a job and the list in turn until stopped."""

    def __init__(self, service, paths):
        super().__init__(daemon=True)
        self.service, self.paths = service, paths
        self.times = {path: [] for path in paths}
        self.over = threading.Event()

    def run(self):
        connection = self.service.connection()
        while not self.over.wait(PAUSE):
            for path in self.paths:
                start = time.perf_counter()
                connection.request("GET", path)
                answer = connection.getresponse()
                answer.read()
                if answer.status != 200:
                    raise SystemExit(f"{path}: {answer.status}")
                self.times[path].append(time.perf_counter() - start)

    def stop(self):
        self.over.set()
        self.join()
        return self.times


def asked(service, paths, work):
    """Seconds per request, by path, while `work` ran; and its result."""
    asking = Asking(service, paths)
    asking.start()
    done = work()
    return asking.stop(), done


class Streams:
    """Event streams of one job, all read by one thread."""

    def __init__(self, service, job, count):
        self.selector = selectors.DefaultSelector()
        self.events = {}
        for _ in range(count):
            stream = socket.create_connection(service.address)
            host = "%s:%d" % service.address
            stream.sendall(f"GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            self.selector.register(stream, selectors.EVENT_READ)
            self.events[stream] = 0
        self.over = False
        self.thread = threading.Thread(target=self.read, daemon=True)
        self.thread.start()

    def read(self):
        while not self.over:
            for key, _ in self.selector.select(0.2):
                piece = key.fileobj.recv(1 << 16)
                if not piece:
                    raise SystemExit("a stream has ended")
                self.events[key.fileobj] += piece.count(b"\nid:") + piece.startswith(b"id:")

    def stop(self):
        """The fewest and the most events of a stream."""
        self.over = True
        self.thread.join()
        for stream in self.events:
            stream.close()
        return min(self.events.values()), max(self.events.values())


def parts(photographs, total):
    """Heads and contents of a form, and the padding after each content, bytes."""
    each = total // len(photographs)
    for path in photographs:
        name = path.name.encode()
        head = b'Content-Disposition: form-data; name="images"; filename="%s"' % name
        content = path.read_bytes()
        yield b"--" + BOUNDARY + b"\r\n" + head + b"\r\n\r\n", content, max(0, each - len(content))


def upload(service, photographs, total):
    """Sends `total` bytes. Returns the seconds until they are sent and until the answer, and the peak memory of the
    server and its children, bytes."""
    form = list(parts(photographs, total))
    end = b"--" + BOUNDARY + b"--\r\n"
    length = sum(len(head) + len(content) + rest + 2 for head, content, rest in form) + len(end)
    nothing = bytes(MIB)
    most = {"children": 0}
    over = threading.Event()

    def watch():
        while not over.wait(0.02):
            held = [memory_of(pid, "VmRSS") for pid in children(service.process.pid)
                    if b"assess-worker" in Path(f"/proc/{pid}/cmdline").read_bytes()]
            most["children"] = max(most["children"], *held, 0)

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    connection = service.connection()
    start = time.perf_counter()
    connection.putrequest("POST", "/v1/captures")
    connection.putheader("Content-Type", "multipart/form-data; boundary=" + BOUNDARY.decode())
    connection.putheader("Content-Length", str(length))
    connection.endheaders()
    for head, content, rest in form:
        connection.send(head + content)
        while rest > 0:
            connection.send(nothing[:min(rest, MIB)])
            rest -= MIB
        connection.send(b"\r\n")
    connection.send(end)
    sent = time.perf_counter() - start
    answer = connection.getresponse()
    content = answer.read()
    answered = time.perf_counter() - start
    over.set()
    watching.join()
    if answer.status != 201:
        raise SystemExit(f"{answer.status} {content.decode()}")
    return length, sent, answered, most["children"]


def begin_job(service, photographs):
    """A job of the photographs that trains."""
    connection = service.connection()
    form = b"".join(head + content + b"\r\n" for head, content, _ in parts(photographs, 0))
    body = form + b"--" + BOUNDARY + b"--\r\n"
    headers = {"Content-Type": "multipart/form-data; boundary=" + BOUNDARY.decode()}
    connection.request("POST", "/v1/captures", body, headers)
    capture = json.loads(connection.getresponse().read())
    order = PLAYED if service.played else ORDER
    job = service.json("POST", "/v1/jobs", {"capture_id": capture["id"], **order}, 202)["id"]
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        shown = service.json("GET", f"/v1/jobs/{job}")
        if shown["state"] not in ("queued", "running"):
            raise SystemExit(f"the job {shown['state']}: {shown.get('error')}")
        trains = shown["stage"] == "reconstruct" and shown.get("steps_per_second")
        if trains or service.played and shown["state"] == "running":
            return job
        time.sleep(0.5)
    raise SystemExit("the job does not train")


def row(name, times):
    """A row of the table: median, p99 and maximum of the requests, ms."""
    cells = []
    for values in times.values():
        ms = [1000 * value for value in values]
        cells.append(f"{share(ms, 0.5):.1f} / {share(ms, 0.99):.1f} / {max(ms):.0f}")
    count = min(len(values) for values in times.values())
    return f"| {name} | {count} | " + " | ".join(cells) + " |"


def measure(service, options):
    photographs = sorted(path for path in options.capture.rglob("*") if path.suffix.lower() in PHOTOGRAPHS
                         and path.parent.name in ("images", options.capture.name))
    if len(photographs) < 3:
        raise SystemExit(f"{options.capture} has no photographs")
    pause = lambda: time.sleep(options.seconds)
    print("| while | requests of each | one job, ms: middle / p99 / most | the list |")
    print("|---|---|---|---|")
    idle, _ = asked(service, ["/livez", "/v1/jobs"], pause)
    print(row("nothing is done (`/livez` in place of the job)", idle), flush=True)
    job = begin_job(service, photographs)
    paths = [f"/v1/jobs/{job}", "/v1/jobs"]
    print(row("a job trains", asked(service, paths, pause)[0]), flush=True)
    streams = Streams(service, job, options.streams)
    print(row(f"and {options.streams} event streams are read", asked(service, paths, pause)[0]), flush=True)
    before = service.memory()
    times, sent = asked(service, paths, lambda: upload(service, photographs, options.bytes))
    print(row(f"and {options.bytes / 1e9:.1f} GB are uploaded", times), flush=True)
    length, seconds, answered, children_held = sent
    fewest, most = streams.stop()
    print(f"\nThe upload: {length / 1e9:.2f} GB of {len(photographs)} photographs sent in {seconds:.1f} s"
          f" ({length / 1e6 / seconds:.0f} MB/s), answered 201 after {answered:.1f} s. The server held at most"
          f" {before / MIB:.0f} MiB before and {service.memory() / MIB:.0f} MiB after it, who looked at it"
          f" {children_held / MIB:.0f} MiB. Every stream had {fewest} to {most} events.")
    service.json("POST", f"/v1/jobs/{job}/cancel", expect=202)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, help="a folder of photographs")
    program = Path(os.environ.get("CARGO_TARGET_DIR", TOP / "target")) / "release/fled"
    parser.add_argument("--fled", type=Path, default=program, help="the program, or fled-fake, whose jobs are played")
    parser.add_argument("--seconds", type=float, default=20, help="how long each row is measured")
    parser.add_argument("--streams", type=int, default=200)
    parser.add_argument("--bytes", type=lambda text: int(float(text)), default=2_000_000_000, help="of the upload")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="fled-load-"))
    try:
        with Service(options.fled, folder) as service:
            measure(service, options)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
