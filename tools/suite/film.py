"""Films a capture: a page with three.js in headless Chromium renders, this side is the camera.

The page fetches its plan and posts every frame as linear light (half floats) to a server of ours,
which makes noise, bytes and the video or photos of it, and writes the truth beside.
"""

import json
import math
import os
import queue
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlparse

import numpy as np

import captures
import sensor
import truth

HERE = os.path.dirname(os.path.abspath(__file__))
DENSITY = 1.2  # rendered pixels per pixel of the picture
MARGIN = 1.08  # rendered field over the picture's, for lens distortion
SILENCE_S = 240  # without a word from the page: it has died
FLAGS = ["--headless", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run", "--use-gl=angle",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-timer-throttling",
         "--disable-renderer-backgrounding", "--window-size=64,64"]
TYPES = {".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm"}


class Server:
    """Serves page, three.js, object and plan; what the page posts comes out of `posts`."""

    def __init__(self, plan, three, model):
        self.posts = queue.Queue(maxsize=3)
        roots = {"web": os.path.join(HERE, "web"), "three": three}
        posts = self.posts

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self):
                path = urlparse(self.path).path
                first, _, rest = path[1:].partition("/")
                if path == "/plan.json":
                    return self.reply(json.dumps(plan).encode(), "application/json")
                file = model if path == "/object.glb" else os.path.join(roots.get(first, "/nowhere"), rest)
                if not file or not os.path.isfile(file):
                    return self.reply(b"", "text/plain", 404)
                with open(file, "rb") as stream:
                    self.reply(stream.read(), TYPES.get(os.path.splitext(file)[1], "application/octet-stream"))

            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                address = urlparse(self.path)
                posts.put((address.path[1:], int(parse_qs(address.query).get("i", ["-1"])[0]), body))
                self.reply(b"", "text/plain")

            def reply(self, body, kind, status=200):
                self.send_response(status)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.http.serve_forever, daemon=True).start()
        self.address = f"http://127.0.0.1:{self.http.server_port}/web/page.html"

    def pictures(self, width, height):
        """(kind, index, light [H, W, 3]) of samples and frames until the page is done."""
        while True:
            try:
                kind, index, body = self.posts.get(timeout=SILENCE_S)
            except queue.Empty:
                raise RuntimeError(f"the page has said nothing for {SILENCE_S} s") from None
            if kind == "failed":
                raise RuntimeError(f"the page failed: {body.decode()}")
            if kind == "done":
                return
            if kind == "size":
                continue
            if kind == "joints":
                yield kind, index, json.loads(body)
                continue
            if kind == "mesh":
                yield kind, index, np.frombuffer(body, np.float32).reshape(-1, 3)
                continue
            yield kind, index, np.frombuffer(body, np.float16).reshape(height, width, 4)[..., :3]


class Browser:
    """Headless Chromium on an address, with a profile of its own; gone afterwards."""

    def __init__(self, address):
        self.address = address

    def __enter__(self):
        self.profile = tempfile.mkdtemp(prefix="suite-chromium-")
        command = ["chromium", *FLAGS, f"--user-data-dir={self.profile}", self.address]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)

    def __exit__(self, *_):
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)


def matrix4(R, t):
    """4x4 of x -> R x + t, by columns, as three.js wants it."""
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = R, t
    return M.T.ravel().tolist()


def plan_of(capture):
    """What the page is told, and the truth: (plan, poses camera_from_body, motion record)."""
    lens, mount = captures.lens_of(capture), captures.mount_of(capture)
    bodies, cameras, record = captures.poses_of(capture, lens, mount)
    flip = np.diag([1.0, -1.0, -1.0])  # three.js looks along -z with y up
    frames = [{"body": matrix4(*body), "camera": matrix4(R.T @ flip, -R.T @ t)} for body, (R, t) in zip(bodies, cameras)]
    count = len(frames)
    record["joints"] = captures.joints_of(capture, count)
    for k, frame in enumerate(frames):
        frame["joints"] = {name: math.radians(j["angles_deg"][k]) for name, j in record["joints"].items()}
    plan = {
        "width": captures.WIDTH, "height": captures.HEIGHT, "lens": lens, "density": DENSITY, "margin": MARGIN,
        "object": capture.object, "mount": mount.T.ravel().tolist(), "ground": captures.ground_of(capture),
        "light": captures.light_of(capture), "room_seed": len(capture.object) + ord(capture.object[0]),
        "pole": capture.motion not in (*captures.TUMBLES, "stand", "moved"), "first": 0, "frames": frames,
        "samples": sorted({round(k * (count - 1) / 5) for k in range(6)}),
    }
    if capture.motion == "moved":
        record["camera_from_room"] = [[R.tolist(), t.tolist()] for R, t in cameras]
    poses = [(R @ B, R @ b + t) for (B, b), (R, t) in zip(bodies, cameras)]
    return plan, poses, record


def encoder(capture, folder, width, height):
    """ffmpeg reading raw RGB: H.264 (4:2:0, BT.709), frame k at k / fps, or JPEG photos."""
    command = ["ffmpeg", "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    if capture.fps:
        colour = ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-color_range", "tv"]
        command += ["-r", str(capture.fps), "-i", "-", "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-c:v", "libx264",
                    "-preset", "medium", "-crf", "16", "-pix_fmt", "yuv420p", *colour, "-bf", "2", "-g", "48", "-threads", "1",
                    "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart", f"{folder}/video.mp4"]
    else:
        os.makedirs(f"{folder}/images")
        command += ["-i", "-", "-pix_fmt", "yuvj420p", "-q:v", "2", "-start_number", "0", f"{folder}/images/still_%03d.jpg"]
    return subprocess.Popen(command, stdin=subprocess.PIPE)


def serve(capture, cache, shared, plan):
    """A server of the page, of three.js and of the capture's object."""
    file = captures.MODELS.get(capture.object)
    model = file and os.path.join(shared, "data/spacecraft_glb", file)
    if model and not os.path.isfile(model):
        raise FileNotFoundError(f"{model} is missing: {capture.object} is not filmed")
    return Server(plan, os.path.join(cache, "web/node_modules/three"), model)


def mesh(capture, cache, shared):
    """Writes `mesh.ply` beside a capture, in the frame of its true poses, unless it is there; its
    path."""
    path = os.path.join(capture.folder(cache), "mesh.ply")
    if not os.path.isfile(path):
        plan = plan_of(capture)[0] | {"mesh": True}
        server = serve(capture, cache, shared, plan)
        with Browser(server.address):
            corners = [array for kind, _, array in server.pictures(plan["width"], plan["height"]) if kind == "mesh"][0]
        server.http.shutdown()
        points, where = np.unique(corners, axis=0, return_inverse=True)
        faces = np.empty(len(where) // 3, [("n", "u1"), ("v", "<i4", 3)])
        faces["n"], faces["v"] = 3, where.reshape(-1, 3)
        with open(path + ".part", "wb") as out:
            out.write((f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\n"
                       f"property float y\nproperty float z\nelement face {len(faces)}\n"
                       "property list uchar int vertex_indices\nend_header\n").encode())
            out.write(points.astype("<f4").tobytes() + faces.tobytes())
        os.rename(path + ".part", path)
    return path


def film(capture, cache, shared):
    """Makes a capture's folder unless it is there; returns (folder, frames, seconds)."""
    folder = capture.folder(cache)
    if os.path.isdir(folder):
        return folder, 0, 0.0
    begun, part = time.time(), f"{folder}.part"
    shutil.rmtree(part, ignore_errors=True)
    os.makedirs(part)
    plan, poses, record = plan_of(capture)
    width, height = plan["width"], plan["height"]
    server = serve(capture, cache, shared, plan)
    samples, eye, clipped, count = [], None, 0.0, 0
    with Browser(server.address):
        sink = encoder(capture, part, width, height)
        for kind, index, light in server.pictures(width, height):
            if kind == "joints":
                for name, place in light.items():
                    record["joints"][name] |= place
                continue
            if kind == "sample":
                samples.append(light)
                continue
            if eye is None:
                exposure = sensor.exposure_for(samples, plan["light"])
                seed = [int(x) for x in capture.rng("noise").integers(0, 2**31, 2)]
                eye = sensor.Sensor(width, height, plan["lens"], plan["light"], exposure, seed)
            picture = eye.picture(light, index)
            clipped += float((picture.min(axis=2) >= 254).mean()) / len(poses)
            sink.stdin.write(picture.tobytes())
            count += 1
        sink.stdin.close()
        if sink.wait() != 0 or count != len(poses):
            raise RuntimeError(f"{count} of {len(poses)} frames of {capture.name} were filmed")
    server.http.shutdown()
    border = max(float(edge.max()) for s in samples for edge in (s[0], s[-1], s[:, 0], s[:, -1]))
    facts = {"exposure": exposure, "clipped_share": clipped, "object_at_border": border > 1e-3 * float(max(s.max() for s in samples))}
    truth.write(part, capture, plan, poses, record, facts)
    os.rename(part, folder)
    return folder, count, time.time() - begun
