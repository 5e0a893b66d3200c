"""Runs the whole product: the service reconstructs a dark capture, with results in demo/.

    make demo

Makes a synthetic capture with ground truth, starts `fled serve` on a free port, uploads the photographs, follows the
job, and writes: before-after.png (dark | round 1 | last round | ground truth), novel views, metrics.json, scene.ply.
"""

import argparse
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
import uuid
import zipfile
from pathlib import Path

from PIL import Image

TOP = Path(__file__).resolve().parent.parent
FOLDER = TOP / "demo"
CAPTURE, DATA = FOLDER / "capture", FOLDER / "data"
# White between the pictures of a row, px.
GAP = 4
# Degrees to the side of and above the photographers.
NOVEL_VIEWS = [(-12, 0), (12, 0), (0, 8)]
PATIENCE = 30 * 60


class Service:
    """`fled serve`, from its start to its end."""

    def __init__(self, program):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = f"127.0.0.1:{probe.getsockname()[1]}"
        self.log = (FOLDER / "server.log").open("wb")
        command = [program, "serve", "--data", DATA, "--listen", self.address, "--workers", "1"]
        self.process = subprocess.Popen(command, stdout=self.log, stderr=self.log, stdin=subprocess.DEVNULL)

    def __enter__(self):
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and self.process.poll() is None:
            try:
                self.get("/livez")
                return self
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.1)
        self.__exit__()
        raise SystemExit(f"the service did not start; its last words:\n{tail(FOLDER / 'server.log')}")

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.log.close()

    def call(self, request):
        try:
            with urllib.request.urlopen(request, timeout=300) as answer:
                return answer.read()
        except urllib.error.HTTPError as error:
            raise SystemExit(f"{request.get_method()} {request.selector}: {error.code} {error.read().decode()}")

    def get(self, path):
        return self.call(urllib.request.Request(f"http://{self.address}{path}"))

    def json(self, path):
        return json.loads(self.get(path))

    def post(self, path, fields, name, content):
        """A multipart form of text fields and one file."""
        mark = uuid.uuid4().hex
        parts = [f'--{mark}\r\nContent-Disposition: form-data; name="{key}"\r\n\r\n{value}\r\n'.encode()
                 for key, value in fields.items()]
        parts.append(f'--{mark}\r\nContent-Disposition: form-data; name="images"; filename="{name}"\r\n'
                     "Content-Type: application/zip\r\n\r\n".encode() + content + f"\r\n--{mark}--\r\n".encode())
        kind = {"Content-Type": f"multipart/form-data; boundary={mark}"}
        return json.loads(self.call(urllib.request.Request(f"http://{self.address}{path}", b"".join(parts), kind)))


def tail(path, lines=15):
    return "\n".join(path.read_text(errors="replace").splitlines()[-lines:])


def zipped(folder):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder).as_posix())
    return content.getvalue()


def drop_leftovers(service):
    """Ends the jobs of an interrupted demo, which the single worker would run first."""
    for state in ("running", "queued"):
        for job in service.json(f"/v1/jobs?state={state}&limit=200")["jobs"]:
            service.call(urllib.request.Request(f"http://{service.address}/v1/jobs/{job['id']}/cancel", b""))


def follow(service, job):
    """Prints the job's state until it ends."""
    deadline, said, said_at = time.monotonic() + PATIENCE, None, 0.0
    while True:
        state = service.json(f"/v1/jobs/{job}")
        if state["state"] in ("succeeded", "failed", "cancelled"):
            return state
        if time.monotonic() > deadline:
            raise SystemExit(f"the job did not end within {PATIENCE // 60} minutes")
        at = (state["state"], state.get("stage"), state.get("round"))
        if at != said or time.monotonic() - said_at > 5:
            said, said_at = at, time.monotonic()
            print(progress_line(state), flush=True)
        time.sleep(0.5)


def progress_line(state):
    line = f"  {100 * state['progress']:5.1f} %  round {state['round']}/{state['rounds']}  {state.get('stage') or state['state']}"
    if state.get("steps_per_second"):
        line += f"  {state['steps_per_second']:.1f} steps/s"
    if state.get("eta_seconds") is not None:
        line += f"  about {state['eta_seconds']:.0f} s left"
    return line


def table(report):
    """Every round's held-out scores against the ground truth, at the final brightness."""
    print("\n  Held-out views against the ground truth, at the final brightness:")
    print(f"  {'round':<7}{'image':<12}{'PSNR dB':>9}{'PSNR cc':>9}{'SSIM':>8}{'views':>7}{'Gaussians':>11}{'steps/s':>9}{'seconds':>9}")
    for row in report["rounds"]:
        for record in row["records"]:
            if (record["split"], record["reference"], record["brightness"]) != ("held_out", "gt", "final"):
                continue
            line = (f"  {row['round']:<7}{record['image']:<12}{record['psnr_db']:9.2f}{record['psnr_cc_db']:9.2f}"
                    f"{record['ssim']:8.4f}{record['views']:7}")
            if record["image"] == "render":
                line += f"{row['gaussians']:11}{row['steps_per_second']:9.1f}{row['seconds']:9.1f}"
            print(line)
    print(f"  delivered: round {report['best_round']}; {report['registered']} of {report['views']} views registered; {report['adapter']}")
    for fallback in report.get("fallbacks", []):
        print(f"  note: {fallback}")


def original(folder, stem):
    """The PNG of a view in a folder of the capture, as RGB."""
    with Image.open(folder / f"{stem}.png") as image:
        return image.convert("RGB")


def beside(pictures):
    """Pictures of one height side by side, with a white gap."""
    heights = {picture.height for picture in pictures}
    if len(heights) != 1:
        raise ValueError(f"pictures of different heights: {sorted(heights)}")
    width = sum(picture.width + GAP for picture in pictures) - GAP
    row, left = Image.new("RGB", (width, heights.pop()), "white"), 0
    for picture in pictures:
        row.paste(picture, (left, 0))
        left += picture.width + GAP
    return row


def before_after(service, job, rounds, cameras):
    """dark | round 1 | last round | ground truth, of a held-out view."""
    held_out = [camera["name"] for camera in cameras if camera["split"] == "held_out"]
    view = (held_out or [camera["name"] for camera in cameras])[0]
    dark, truth = original(CAPTURE / "images", view), original(CAPTURE / "HL", view)
    path = f"/v1/jobs/{job}/render?view={view}&width={dark.width}&height={dark.height}&format=png"
    answers = [service.get(f"{path}&round={round}") for round in sorted({1, rounds})]
    renders = [Image.open(io.BytesIO(answer)).convert("RGB") for answer in answers]
    beside([dark, *renders, truth]).save(FOLDER / "before-after.png")
    return view


def novel_views(service, job):
    for number, (azimuth, elevation) in enumerate(NOVEL_VIEWS, 1):
        path = f"/v1/jobs/{job}/render?azimuth={azimuth}&elevation={elevation}&width=640&format=png"
        (FOLDER / f"novel-{number}.png").write_bytes(service.get(path))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    target = Path(os.environ.get("CARGO_TARGET_DIR", TOP / "target"))
    parser.add_argument("--fled", type=Path, default=target / "release" / "fled", help="the program")
    parser.add_argument("--preset", default="preview")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="an option of the job")
    arguments = parser.parse_args()
    if not arguments.fled.is_file():
        raise SystemExit(f"{arguments.fled} is missing: run `make build`")
    options = dict(pair.split("=", 1) for pair in arguments.set)
    # The capture includes true poses, but finding poses is part of the demo.
    options = {"pose_source": "colmap"} | {key: number(value) for key, value in options.items()}
    started = time.monotonic()
    FOLDER.mkdir(exist_ok=True)
    shutil.rmtree(CAPTURE, ignore_errors=True)
    print("Making a dark, shaken capture with ground truth", flush=True)
    subprocess.run([arguments.fled, "synth", CAPTURE, "--room", "study"], check=True)
    with Service(arguments.fled) as service:
        print(f"The service listens on http://{service.address}", flush=True)
        drop_leftovers(service)
        fields = {"name": "demo", "preset": arguments.preset, "options": json.dumps(options)}
        job = service.post("/v1/jobs", fields, "capture.zip", zipped(CAPTURE))["id"]
        state = follow(service, job)
        if state["state"] != "succeeded":
            (FOLDER / "job.log").write_bytes(service.get(f"/v1/jobs/{job}/log"))
            raise SystemExit(f"the job ended {state['state']}: {json.dumps(state['error'])}; see demo/job.log")
        for name in ("metrics.json", "cameras.json", "scene.ply"):
            (FOLDER / name).write_bytes(service.get(f"/v1/jobs/{job}/artifacts/{name}"))
        report = json.loads((FOLDER / "metrics.json").read_text())
        table(report)
        view = before_after(service, job, len(report["rounds"]), json.loads((FOLDER / "cameras.json").read_text()))
        novel_views(service, job)
    rounds = " | ".join(f"round {number}" for number in sorted({1, len(report["rounds"])}))
    print(f"\n  demo/before-after.png   dark | {rounds} | ground truth, view {view}")
    print(f"  demo/novel-1.png ...    {len(NOVEL_VIEWS)} views that nobody photographed")
    print("  demo/scene.ply          for any viewer of 3D Gaussian splats")
    print(f"\n{time.monotonic() - started:.0f} s. The dashboard on the same data:")
    print(f"  {os.path.relpath(arguments.fled)} serve --data {os.path.relpath(DATA)} --listen 127.0.0.1:8080")


def number(text):
    """The value of an option: JSON where it is JSON, else a word."""
    try:
        return json.loads(text)
    except ValueError:
        return text


if __name__ == "__main__":
    sys.exit(main())
