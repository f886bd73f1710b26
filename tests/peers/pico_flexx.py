"""A ROS 2 driver of the pico flexx, an independent rosbridge server, and our camera behind it. Run by pico_flexx.sh."""

import ctypes.util
import os
import re
import socket
import subprocess
import sys
import sysconfig
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

WIDTH, HEIGHT = 224, 172
PERIOD_NS = 100_000_000
PORT = 9190


def check(what, ok, detail=""):
    """Prints a line; ends everything when it is not so."""
    if not ok:
        sys.exit(f"FAILED {what}: {detail}")
    print(f"ok     {what}{': ' if detail else ''}{detail}", flush=True)


def publish():
    """What the driver publishes, ten times a second: frame n has 1 m and n mm everywhere but in its first row."""
    import numpy as np
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField

    rclpy.init()
    node = rclpy.create_node("pico_flexx")
    base = "/pico_flexx"
    info_out = node.create_publisher(CameraInfo, f"{base}/camera_info", qos_profile_sensor_data)
    image_out = node.create_publisher(Image, f"{base}/image_depth", qos_profile_sensor_data)
    points_out = node.create_publisher(PointCloud2, f"{base}/points", qos_profile_sensor_data)
    info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", d=[0.4, -2.5, 0.001, -0.002, 3.5])
    info.k = [212.5, 0.0, 112.5, 0.0, 212.75, 86.25, 0.0, 0.0, 1.0]
    image = Image(width=WIDTH, height=HEIGHT, encoding="32FC1", step=WIDTH * 4)
    kind = PointField
    fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("noise", 12, 7), ("intensity", 16, 4), ("gray", 18, 2)]
    points = PointCloud2(width=WIDTH, height=HEIGHT, point_step=19, row_step=19 * WIDTH, is_dense=False)
    points.fields = [kind(name=name, offset=offset, datatype=datatype, count=1) for name, offset, datatype in fields]
    layout = np.dtype({"names": [f[0] for f in fields], "formats": ["<f4"] * 4 + ["<u2", "u1"], "offsets": [f[1] for f in fields], "itemsize": 19})
    cloud = np.zeros((HEIGHT, WIDTH), layout)
    depth = np.zeros((HEIGHT, WIDTH), np.float32)
    n = 0
    while rclpy.ok():
        began = time.monotonic()
        n += 1
        ns = 1_700_000_000 * 10**9 + n * PERIOD_NS
        for message in (info, image, points):
            message.header.frame_id = "pico_flexx_optical_frame"
            message.header.stamp.sec, message.header.stamp.nanosec = ns // 10**9, ns % 10**9
        depth[:] = 1 + n * 1e-3
        depth[0] = 0
        cloud["z"], cloud["noise"] = depth, 0.01
        cloud["z"][0] = np.nan
        # Too much noise: half of the second row.
        cloud["noise"][1, : WIDTH // 2] = 0.2
        image.data = depth.tobytes()
        points.data = cloud.tobytes()
        info_out.publish(info)
        image_out.publish(image)
        points_out.publish(points)
        time.sleep(max(0.0, PERIOD_NS * 1e-9 - (time.monotonic() - began)))


def environment():
    """What the server needs to find the libraries that lie in the Python environment."""
    prefix = Path(sys.prefix)
    # The libraries of ROS bind one middleware by name; the server asks for it by its general name.
    shim = Path(tempfile.mkdtemp())
    (shim / "librmw_implementation.so").symlink_to(prefix / "lib" / "librmw_fastrtps_cpp.so")
    folders = {shim, prefix / "lib"}
    folders |= {path.parent for path in prefix.glob("lib/python*/site-packages/*.libs/*.so*")}
    python = Path(sysconfig.get_config_var("LIBDIR")) / (sysconfig.get_config_var("INSTSONAME") or "")
    preload = str(python) if python.is_file() else ctypes.util.find_library(f"python{sysconfig.get_python_version()}")
    return os.environ | {
        "LD_LIBRARY_PATH": ":".join(str(folder) for folder in folders),
        "LD_PRELOAD": preload or "",
        "AMENT_PREFIX_PATH": str(prefix),
        "ROS_DISTRO": "jazzy",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


def server():
    import rosbridge_server_rs

    binary = Path(rosbridge_server_rs.__file__).with_name("rosbridge_server_rs_jazzy")
    binary.chmod(0o755)
    command = [str(binary), "--bind", f"127.0.0.1:{PORT}", "--no-rosapi", "--log-level", "error"]
    return subprocess.Popen(command, env=environment(), stdout=subprocess.DEVNULL)


def until_open(process):
    for _ in range(200):
        if process.poll() is not None:
            sys.exit(f"FAILED the rosbridge server ended with {process.returncode}")
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", PORT)) == 0:
                return
        time.sleep(0.1)
    sys.exit("FAILED the rosbridge server does not listen")


def watch(program, depth, topic, pixels, frames=15):
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(
            f'silence_ms = 10000\n[source]\nkind = "rosbridge"\nurl = "ws://127.0.0.1:{PORT}"\ndepth = "{depth}"\n'
            f'topic = "{topic}"\ncamera_info = "/pico_flexx/camera_info"\nuse_case = "MODE_9_10FPS_1000"\n'
        )
        file.flush()
        out = subprocess.run([program, file.name, str(frames)], capture_output=True, text=True, timeout=120, check=False)
    if out.returncode:
        sys.exit(f"FAILED {depth}: {out.stdout}\n{out.stderr}")
    check(f"{depth}: lens", "distortion: [0.4, -2.5, 0.001, -0.002, 3.5, 0.0, 0.0, 0.0]" in out.stdout)
    found = re.findall(r"^frame (\d+) (\d+) (\d+) ([\d.]+) ([\d.]+) ([\d.]+)$", out.stdout, re.M)
    check(f"{depth}: frames", len(found) == frames, str(len(found)))
    before = None
    for sequence, stamp, seen, mean, middle, _ in found:
        n = (int(stamp) - 1_700_000_000 * 10**9) // PERIOD_NS
        expected = 1 + n * 1e-3
        right = int(seen) == pixels and abs(float(mean) - expected) < 2e-6 and abs(float(middle) - expected) < 2e-6
        if not right:
            sys.exit(f"FAILED {depth}: frame {n} has {seen} pixels of {mean} m, expected {pixels} of {expected} m")
        if before:
            counted = int(sequence) - before[0]
            if counted != n - before[1]:
                sys.exit(f"FAILED {depth}: counted {counted} exposures, there were {n - before[1]}")
        before = int(sequence), n
    ages = sorted(float(line[-1]) for line in found)
    check(f"{depth}: every depth, stamp and number", True, f"ages {ages[0]:.0f} to {ages[-1]:.0f} ms, of which {PERIOD_NS // 10**6} are assumed")


def main():
    print("rclpy", version("ros-kilted-rclpy"), "rosbridge-server-rs", version("rosbridge-server-rs"), flush=True)
    bridge = server()
    driver = None
    try:
        until_open(bridge)
        driver = subprocess.Popen([sys.executable, __file__, "publish"], env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
        time.sleep(5)
        whole = WIDTH * HEIGHT - WIDTH
        watch(sys.argv[1], "image", "/pico_flexx/image_depth", whole)
        watch(sys.argv[1], "points", "/pico_flexx/points", whole - WIDTH // 2)
    finally:
        for process in (driver, bridge):
            if process:
                process.terminate()
                process.wait(10)
    print("all ok")


if sys.argv[1] == "publish":
    try:
        publish()
    except KeyboardInterrupt:
        pass
else:
    main()
