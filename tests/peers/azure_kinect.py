"""The Azure Kinect SDK against our recordings, calibration and lens. Run by azure_kinect.sh."""

import ctypes as c
import json
import os
import random
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pyk4a

MODES = {
    "NFOV_2X2BINNED": (1, 320, 288),
    "NFOV_UNBINNED": (2, 640, 576),
    "WFOV_2X2BINNED": (3, 512, 512),
    "WFOV_UNBINNED": (4, 1024, 1024),
}
P720, DEPTH_CAMERA, COLOR_CAMERA = 1, 0, 1
DEPTH16, IR16, CUSTOM = 4, 5, 8
COLOR_OFF = 0


class Configuration(c.Structure):
    _fields_ = [
        ("color_format", c.c_int32),
        ("color_resolution", c.c_int32),
        ("depth_mode", c.c_int32),
        ("camera_fps", c.c_int32),
        ("synchronized_images_only", c.c_bool),
        ("depth_delay_off_color_usec", c.c_int32),
        ("wired_sync_mode", c.c_int32),
        ("subordinate_delay_off_master_usec", c.c_uint32),
        ("disable_streaming_indicator", c.c_bool),
    ]


def libraries():
    folder = Path(pyk4a.__file__).parents[1] / "pyk4a_bundle.libs"
    (k4a,) = folder.glob("libk4a-*.so*")
    (record,) = folder.glob("libk4arecord-*.so*")
    return k4a, c.CDLL(str(k4a), mode=c.RTLD_GLOBAL), c.CDLL(str(record))


K4A_PATH, K4A, RECORD = libraries()
for name in ("k4a_image_get_buffer", "k4a_transformation_create"):
    getattr(K4A, name).restype = c.c_void_p


def check(what, ok, detail=""):
    """Prints a line; ends everything when it is not so."""
    if not ok:
        sys.exit(f"FAILED {what}: {detail}")
    print(f"ok     {what}{': ' if detail else ''}{detail}")


def done(what, result):
    if result != 0:
        sys.exit(f"FAILED {what}: result {result}")


def run(peer, *words, text=None):
    words = [str(word) for word in words]
    return subprocess.run([peer, *words], input=text, capture_output=True, text=True, check=True).stdout


def sums(image):
    flat = image.reshape(-1).astype(np.uint64)
    return int(flat.sum()), int((flat * np.arange(1, flat.size + 1, dtype=np.uint64)).sum())


def image(kind, values, stamp_us):
    """An image of the SDK with these values."""
    height, width = values.shape
    handle = c.c_void_p()
    done("image", K4A.k4a_image_create(kind, width, height, width * 2, c.byref(handle)))
    c.memmove(K4A.k4a_image_get_buffer(handle), values.tobytes(), values.nbytes)
    K4A.k4a_image_set_device_timestamp_usec(handle, c.c_uint64(stamp_us))
    return handle


def write_recording(path, mode, calibration, frames):
    """A recording written by the SDK's own recorder; the lines that our reader must print for it."""
    code, width, height = MODES[mode]
    settings = Configuration(0, COLOR_OFF, code, 1, False, 0, 0, 0, False)
    recorder = c.c_void_p()
    RECORD.k4a_record_create.argtypes = [c.c_char_p, c.c_void_p, Configuration, c.POINTER(c.c_void_p)]
    done("record", RECORD.k4a_record_create(str(path).encode(), None, settings, c.byref(recorder)))
    done("tag", RECORD.k4a_record_add_tag(recorder, b"K4A_CALIBRATION_FILE", b"calibration.json"))
    attach = RECORD.k4a_record_add_attachment
    attach.argtypes = [c.c_void_p, c.c_char_p, c.c_char_p, c.c_size_t]
    done("attachment", attach(recorder, b"calibration.json", calibration, len(calibration)))
    done("header", RECORD.k4a_record_write_header(recorder))
    generator = np.random.default_rng(7)
    lines = []
    for n in range(frames):
        stamp_us = 2_000_000 + n * 66_667
        capture = c.c_void_p()
        done("capture", K4A.k4a_capture_create(c.byref(capture)))
        for kind, name, put in (
            (DEPTH16, "Depth", K4A.k4a_capture_set_depth_image),
            (IR16, "Infrared", K4A.k4a_capture_set_ir_image),
        ):
            values = generator.integers(0, 5000, (height, width), dtype=np.uint16)
            handle = image(kind, values, stamp_us)
            put(capture, handle)
            K4A.k4a_image_release(handle)
            plain, placed = sums(values)
            lines.append(f"{name} {stamp_us} {plain} {placed}")
        done("write", RECORD.k4a_record_write_capture(recorder, capture))
        K4A.k4a_capture_release(capture)
    done("flush", RECORD.k4a_record_flush(recorder))
    RECORD.k4a_record_close(recorder)
    return lines


def read_recording(path):
    """The same lines, as pyk4a reads them."""
    playback = pyk4a.PyK4APlayback(str(path))
    playback.open()
    lines = []
    while True:
        try:
            capture = playback.get_next_capture()
        except EOFError:
            break
        for name, values, stamp in (
            ("Depth", capture.depth, capture.depth_timestamp_usec),
            ("Infrared", capture.ir, capture.ir_timestamp_usec),
        ):
            if values is not None:
                plain, placed = sums(values)
                lines.append(f"{name} {stamp} {plain} {placed}")
    about = playback.configuration
    playback.close()
    return lines, about


def recordings(peer, folder, calibration):
    for mode in MODES:
        path = folder / f"{mode}.mkv"
        expected = write_recording(path, mode, calibration, 4)
        ours = run(peer, "images", path).splitlines()
        check(f"libk4arecord writes {mode}, our reader", sorted(ours) == sorted(expected), f"{len(ours)} images")
        theirs, _ = read_recording(path)
        check("... and pyk4a reads the same", sorted(theirs) == sorted(expected), f"{len(theirs)} images")

        path = folder / f"ours-{mode}.mkv"
        expected = run(peer, "record", path, mode, 4).splitlines()
        theirs, about = read_recording(path)
        check(f"we write {mode}, pyk4a reads it", sorted(theirs) == sorted(expected), f"{len(theirs)} images, {about['depth_mode']}")


def lens(peer, folder, name, path, text):
    for mode, (code, width, height) in MODES.items():
        calibration = c.create_string_buffer(1032)
        raw = text + b"\0"
        done("calibration", K4A.k4a_calibration_get_from_raw(raw, c.c_size_t(len(raw)), code, P720, calibration))
        theirs = np.frombuffer(calibration, np.float32, 4, 48 + 8)
        out = folder / "rays.bin"
        ours = np.array([float(v) for v in run(peer, "rays", path, mode, out).split()])
        worst = float(np.abs(ours - theirs).max())
        check(f"{name}, {mode}: cx cy fx fy", worst < 1e-3, f"worst difference {worst:.1e} px")
        rays = np.fromfile(out, np.float32).reshape(height, width, 2)

        generator = random.Random(3)
        pixels = [(generator.randrange(width), generator.randrange(height)) for _ in range(3000)]
        pixels += [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)]
        worst, same = 0.0, 0
        asked = []
        for u, v in pixels:
            pixel, point, valid = (c.c_float * 2)(u, v), (c.c_float * 3)(), c.c_int(0)
            done(
                "2d to 3d",
                K4A.k4a_calibration_2d_to_3d(
                    calibration, pixel, c.c_float(1000.0), DEPTH_CAMERA, DEPTH_CAMERA, point, c.byref(valid)
                ),
            )
            seen = not np.isnan(rays[v, u, 0])
            if seen != bool(valid.value):
                sys.exit(f"FAILED {mode} pixel {u} {v}: the SDK says valid={valid.value}, we say {seen}")
            same += 1
            if seen:
                worst = max(worst, float(np.hypot(*(1000 * rays[v, u] - np.array(point[:2])))))
                asked.append((u, v))
        check(f"{name}, {mode}: 2d to 3d", worst < 0.01, f"{same} pixels agree on validity, worst {worst:.1e} mm at 1 m")

        lines, expected = [], []
        for u, v in asked:
            mm = generator.uniform(400, 3000)
            pixel, color, valid = (c.c_float * 2)(u, v), (c.c_float * 2)(), c.c_int(0)
            done(
                "2d to 2d",
                K4A.k4a_calibration_2d_to_2d(
                    calibration, pixel, c.c_float(mm), DEPTH_CAMERA, COLOR_CAMERA, color, c.byref(valid)
                ),
            )
            lines.append(f"{u} {v} {mm}")
            expected.append(tuple(color) if valid.value else None)
        answers = run(peer, "color", path, mode, text="\n".join(lines)).splitlines()
        worst, both, inside = 0.0, 0, 0
        for answer, theirs in zip(answers, expected, strict=True):
            if answer == "none" or theirs is None:
                # The SDK also calls pixels outside the image invalid.
                if answer == "none" and theirs is not None:
                    sys.exit(f"FAILED {mode}: the SDK sees {theirs}, we see nothing")
                continue
            ours = np.array([float(v) for v in answer.split()])
            worst = max(worst, float(np.hypot(*(ours - np.array(theirs)))))
            both += 1
        check(f"{name}, {mode}: depth pixel to colour pixel", worst < 0.05 and both > 300, f"{both} pixels, worst {worst:.1e} px")

        transform(name, mode, calibration, rays)


def transform(name, mode, calibration, rays):
    """The SDK's closed engine: depth image to point cloud, 16-bit millimetres."""
    height, width, _ = rays.shape
    handle = K4A.k4a_transformation_create(calibration)
    if not handle:
        print(f"LEFT OUT {name}, {mode}: point cloud: the engine does not start (needs OpenGL and a display, see xvfb-run)")
        if os.environ.get("GRASPD_REQUIRE_XVFB"):
            sys.exit(1)
        return
    handle = c.c_void_p(handle)
    generator = np.random.default_rng(11)
    depth = generator.integers(300, 4000, (height, width), dtype=np.uint16)
    depth[generator.random((height, width)) < 0.1] = 0
    source = image(DEPTH16, depth, 0)
    cloud = c.c_void_p()
    done("cloud image", K4A.k4a_image_create(CUSTOM, width, height, width * 6, c.byref(cloud)))
    done("point cloud", K4A.k4a_transformation_depth_image_to_point_cloud(handle, source, DEPTH_CAMERA, cloud))
    buffer = (c.c_int16 * (width * height * 3)).from_address(K4A.k4a_image_get_buffer(cloud))
    theirs = np.frombuffer(buffer, np.int16).reshape(height, width, 3).astype(np.int32)
    seen = ~np.isnan(rays[..., 0]) & (depth > 0)
    both = seen & (theirs[..., 2] != 0)
    z = depth.astype(np.float64)[..., None]
    ours = np.concatenate([rays * z, z], axis=-1)
    worst = float(np.abs(ours[both] - theirs[both]).max())
    only = int((seen != (theirs[..., 2] != 0)).sum())
    check(
        f"{name}, {mode}: point cloud",
        worst <= 1.0 and only == 0,
        f"{int(both.sum())} points, worst {worst:.2f} mm (theirs are whole), {only} pixels that only one sees",
    )
    K4A.k4a_image_release(source)
    K4A.k4a_image_release(cloud)
    K4A.k4a_transformation_destroy(handle)


def library(peer):
    out = run(peer, "check", K4A_PATH)
    # The SDK logs to the standard output as well.
    lines = [line for line in out.splitlines() if line.startswith(("good ", "bad "))]
    check("our loader takes the SDK's library", lines[0].startswith("good library"), lines[0])
    check("images through its functions", lines[1].startswith("good images"), lines[1])
    check("no device is said so", lines[2].startswith("bad devices: none"), lines[2])
    check("no frame without a device", "no Azure Kinect is on the bus" in lines[3], lines[3][:100])


def main():
    peer = sys.argv[1]
    print("pyk4a-bundle", version("pyk4a-bundle"), "numpy", np.__version__)
    example = Path("adapters/azure-kinect/src/example_calibration.json")
    library(peer)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings(peer, folder, example.read_bytes())
        lens(peer, folder, "example calibration", example, example.read_bytes())
        for path in sys.argv[2:]:
            theirs, about = read_recording(path)
            ours = run(peer, "images", path).splitlines()
            check(f"{path}: images", sorted(ours) == sorted(theirs), f"{len(ours)}, {about['depth_mode']}")
            playback = pyk4a.PyK4APlayback(path)
            playback.open()
            text = playback.calibration_raw.encode()
            playback.close()
            json.loads(text.decode("utf-8-sig").rstrip("\0"))
            copy = folder / "real.json"
            copy.write_bytes(text.rstrip(b"\0"))
            lens(peer, folder, "real calibration", copy, text.rstrip(b"\0"))
    print("all ok")


main()
