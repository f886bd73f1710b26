"""The ROS 2 bridge as users of rclpy and RViz meet it: a camera, goals, a service, results. Run by ros2.sh.

ros2.py GRASPD GRASPD-ROS2: starts a server and bridges, is the camera and the user, and checks what comes.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import defaultdict
from importlib.metadata import version

os.environ["ROS_DOMAIN_ID"] = "42"

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

SERVER, METRICS = "127.0.0.1:50951", "127.0.0.1:50952"
FRAME = "camera_depth_optical_frame"
WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
# A box on a table and where the camera stands; metres, the table's frame, z up.
BOX = np.array([0.04, 0.07, 0.08])
EYE, LOOKS_AT = np.array([0.05, -0.30, 0.55]), np.array([0.0, 0.0, 0.02])
# A slow and busy machine.
PATIENCE = 120


def check(what, ok, detail=""):
    """Prints a line; ends everything when it is not so."""
    if not ok:
        sys.exit(f"FAILED {what}: {detail}")
    print(f"ok     {what}{': ' if detail else ''}{detail}", flush=True)


def until(what, find, seconds=PATIENCE):
    """Waits for something that is true."""
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        found = find()
        if found:
            return found
        time.sleep(0.02)
    sys.exit(f"FAILED {what}: not within {seconds} s")


def camera_axes():
    """The camera's axes in the table's frame, as columns: x right, y down, z forward."""
    forward = (LOOKS_AT - EYE) / np.linalg.norm(LOOKS_AT - EYE)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])


def depth_m(width=WIDTH, height=HEIGHT, focal=FOCAL, box=BOX):
    """The box on its table as the camera sees it: a ray through each pixel."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - width / 2 + 0.5) / focal, (v - height / 2 + 0.5) / focal, np.ones_like(u)], -1) @ camera_axes().T
    depth = -EYE[2] / rays[..., 2]
    center = np.array([0.0, 0.0, box[2] / 2])
    near, far = (center - box / 2 - EYE) / rays, (center + box / 2 - EYE) / rays
    enter, leave = np.minimum(near, far).max(-1), np.maximum(near, far).min(-1)
    return np.where(enter < leave, np.minimum(enter, depth), depth)


def in_camera(point):
    """A point of the table's frame in the camera's."""
    return camera_axes().T @ (np.asarray(point) - EYE)


OBJECT = in_camera([0.0, 0.0, BOX[2] / 2])


def xyz(point):
    take = point.get if isinstance(point, dict) else lambda name: getattr(point, name)
    return np.array([take("x"), take("y"), take("z")])


class Camera:
    """Publishes an image and its camera info five times a second, with new stamps."""

    def __init__(self, node, base, name="image_rect_raw", labels=None):
        self.images = node.create_publisher(Image, f"{base}/{name}", qos_profile_sensor_data)
        self.infos = node.create_publisher(CameraInfo, f"{base}/camera_info", qos_profile_sensor_data)
        self.labels = node.create_publisher(Image, labels, qos_profile_sensor_data) if labels else None
        self.info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", d=[0.0] * 5)
        self.info.k = [FOCAL, 0.0, WIDTH / 2 - 0.5, 0.0, FOCAL, HEIGHT / 2 - 0.5, 0.0, 0.0, 1.0]
        self.image, self.stamps, self.running, self.node = None, [], False, node
        self.depth = depth_m()
        self.label_bytes = (self.depth < depth_m(box=np.zeros(3)) - 1e-6).astype(np.uint8).tobytes()
        self.millimetres()
        node.create_timer(0.2, self.publish)

    def millimetres(self):
        data = np.rint(self.depth * 1000).astype("<u2")
        self.image = Image(width=WIDTH, height=HEIGHT, encoding="16UC1", step=WIDTH * 2, data=data.tobytes())

    def metres_big_endian(self):
        """The other encoding, the other order of bytes, and 12 bytes behind each row."""
        rows = self.depth.astype(">f4").view(np.uint8).reshape(HEIGHT, WIDTH * 4)
        padded = np.pad(rows, ((0, 0), (0, 12)), constant_values=0xAA)
        self.image = Image(width=WIDTH, height=HEIGHT, encoding="32FC1", is_bigendian=1, step=WIDTH * 4 + 12, data=padded.tobytes())

    def colours(self):
        self.image = Image(width=WIDTH, height=HEIGHT, encoding="rgb8", step=WIDTH * 3, data=bytes(WIDTH * HEIGHT * 3))

    def large(self):
        """As a stereo camera's: 1.8 MB an image, hundreds of fragments."""
        width, height, focal = 1280, 720, 900.0
        data = np.rint(depth_m(width, height, focal) * 1000).astype("<u2")
        self.image = Image(width=width, height=height, encoding="16UC1", step=width * 2, data=data.tobytes())
        self.info.width, self.info.height = width, height
        self.info.k = [focal, 0.0, width / 2 - 0.5, 0.0, focal, height / 2 - 0.5, 0.0, 0.0, 1.0]

    def publish(self):
        if not self.running:
            return
        stamp = self.node.get_clock().now().to_msg()
        self.stamps.append((stamp.sec, stamp.nanosec))
        for message in (self.info, self.image):
            message.header.frame_id, message.header.stamp = FRAME, stamp
        self.infos.publish(self.info)
        self.images.publish(self.image)
        if self.labels:
            labels = Image(width=WIDTH, height=HEIGHT, encoding="mono8", step=WIDTH, data=self.label_bytes)
            labels.header = self.image.header
            self.labels.publish(labels)


class User:
    """Subscribes as RViz and programs do, and keeps what comes."""

    def __init__(self, node, base):
        self.node, self.base = node, base
        self.came = defaultdict(list)
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
        # RViz's displays subscribe volatile unless told otherwise.
        for kind, topic, qos in [
            (PoseArray, "grasps", 10),
            (PoseArray, "pregrasps", 10),
            (PoseStamped, "best_grasp", latched),
            (JointState, "joint_state", latched),
            (JointTrajectory, "joint_trajectory", latched),
            (MarkerArray, "markers", QoSProfile(depth=100)),
            (String, "feedback", 10),
            (String, "result", 10),
            (String, "status", latched),
        ]:
            node.create_subscription(kind, f"{base}/{topic}", self.came[topic].append, qos)
        node.create_subscription(DiagnosticArray, "/diagnostics", self.came["diagnostics"].append, 10)
        self.goals = node.create_publisher(String, f"{base}/goal", 10)
        self.cancels = node.create_publisher(String, f"{base}/cancel", 10)
        self.service = node.create_client(Trigger, f"{base}/plan_grasps")

    def goal(self, **fields):
        self.goals.publish(String(data=json.dumps(fields)))

    def result(self, goal, number=1):
        """The number-th result of a goal."""

        def find():
            found = [r for r in map(json.loads, (m.data for m in list(self.came["result"]))) if r["goal_id"] == goal]
            return found[number - 1 :]

        return until(f"a result of {goal}", find)[0]

    def status(self, fits):
        def find():
            last = self.came["status"][-1:]
            status = json.loads(last[0].data) if last else None
            return status if status and fits(status) else None

        return until("a status", find)

    def call(self, service=None):
        service = service or self.service
        check(f"{service.srv_name} is there", service.wait_for_service(PATIENCE))
        future = service.call_async(Trigger.Request())
        until(f"an answer of {service.srv_name}", future.done)
        return future.result()


def of_stamp(messages, stamp):
    return [m for m in list(messages) if (m.header.stamp.sec, m.header.stamp.nanosec) == stamp]


def at_the_object(what, result, camera):
    """A result's frame, stamp, and grasps: fingers about the box."""
    check(f"{what}: succeeded", result["state"] == "succeeded", f"{len(result.get('grasps', []))} grasps {result['message']}")
    stamp = result["stamp"]["sec"], result["stamp"]["nanosec"]
    check(f"{what}: frame and stamp are an image's", result["frame_id"] == FRAME and stamp in camera.stamps)
    away = [np.linalg.norm(xyz(g["tool_point"]) - OBJECT) for g in result["grasps"]]
    touched = [np.linalg.norm(xyz(c["point"]) - OBJECT) for g in result["grasps"] for c in g["contacts"]]
    check(
        f"{what}: fingers about the box, contacts on it",
        max(away) < np.linalg.norm(BOX) and max(touched) < np.linalg.norm(BOX) / 2 + 0.02,
        f"tool points within {max(away) * 1000:.0f} mm of its middle, contacts within {max(touched) * 1000:.0f} mm",
    )
    scores = [g["score"] for g in result["grasps"]]
    check(f"{what}: best first", scores == sorted(scores, reverse=True), f"scores {scores[0]:.2f} to {scores[-1]:.2f}")
    return stamp


def published(user, result, stamp):
    """What was published for a result says the same as the result."""
    poses = until("grasps", lambda: of_stamp(user.came["grasps"], stamp))[-1]
    grasps = result["grasps"]
    check("PoseArray", poses.header.frame_id == FRAME and len(poses.poses) == len(grasps), f"{len(grasps)} poses")
    same = all(np.allclose(xyz(p.position), xyz(g["pose"]["position"])) for p, g in zip(poses.poses, grasps))
    check("PoseArray: the result's poses", same)
    unit = all(abs(np.linalg.norm([q.x, q.y, q.z, q.w]) - 1) < 1e-9 for q in (p.orientation for p in poses.poses))
    check("PoseArray: unit quaternions", unit)
    pregrasps = until("pregrasps", lambda: of_stamp(user.came["pregrasps"], stamp))[-1]
    gap = np.linalg.norm(xyz(pregrasps.poses[0].position) - xyz(poses.poses[0].position))
    check("pre-grasps", len(pregrasps.poses) == len(grasps) and 0.05 < gap < 0.2, f"{gap:.3f} m before")
    best = until("best grasp", lambda: of_stamp(user.came["best_grasp"], stamp))[-1]
    check("PoseStamped is the first pose", best.pose == poses.poses[0] and best.header == poses.header)
    joints = until("joints", lambda: of_stamp(user.came["joint_state"], stamp))[-1]
    named = grasps[0]["joints"]
    check("JointState", list(joints.name) == named["names"] and np.allclose(joints.position, named["contact"]), ", ".join(joints.name))
    trajectory = until("trajectory", lambda: list(user.came["joint_trajectory"]))[-1]
    points = trajectory.points
    check(
        "JointTrajectory: open, contact, squeezed",
        trajectory.joint_names == named["names"]
        and [p.time_from_start.sec for p in points] == [1, 2, 3]
        and all(np.allclose(p.positions, named[m]) for p, m in zip(points, ("open", "contact", "squeezed"))),
    )
    array = until("markers", lambda: [a for a in list(user.came["markers"]) if of_stamp(a.markers, stamp)])[-1]
    by_name = defaultdict(list)
    for marker in array.markers:
        by_name[marker.ns].append(marker)
    check("MarkerArray deletes what was there", array.markers[0].action == Marker.DELETEALL)
    frames = {m.header.frame_id for m in array.markers}
    unique = len({(m.ns, m.id) for m in array.markers}) == len(array.markers)
    check("MarkerArray: frames and ids", frames == {FRAME} and unique)
    # Nothing of a gripper is further from what it holds than its own length.
    distances = [np.linalg.norm(xyz(m.pose.position) - OBJECT) for m in by_name["hand"]]
    check(
        "MarkerArray: the hand at the object",
        len(by_name["hand"]) > 3 and max(distances) < 0.3 and min(distances) < 0.1,
        f"{len(by_name['hand'])} shapes, {min(distances):.3f} to {max(distances):.3f} m from the object",
    )
    shown = min(3, len(grasps))
    check("MarkerArray: scores and arrows", len(by_name["score"]) == len(by_name["approach"]) == shown)


def running_jobs():
    with urllib.request.urlopen(f"http://{METRICS}/metrics", timeout=10) as page:
        return int(re.search(r"^\w*jobs_running (\d+)", page.read().decode(), re.M)[1])


class Programs:
    """What was started, and ends with this."""

    def __init__(self, graspd, bridge):
        self.graspd, self.bridge_program, self.all = graspd, bridge, []

    def start(self, *command):
        process = subprocess.Popen(list(map(str, command)))
        self.all.append(process)
        return process

    def server(self):
        return self.start(self.graspd, "serve", "--listen", SERVER, "--metrics-listen", METRICS)

    def bridge(self, *options):
        return self.start(self.bridge_program, "--server", f"http://{SERVER}", "--timeout-s", "100", *options)

    def end(self):
        for process in self.all:
            if process.poll() is None:
                process.kill()
                process.wait()


def main(programs):
    print("rclpy", version("ros-kilted-rclpy"), os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"), flush=True)
    rclpy.init()
    node = rclpy.create_node("user")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    camera = Camera(node, "/camera/depth", labels="/camera/labels")
    user = User(node, "/graspd")
    threading.Thread(target=executor.spin, daemon=True).start()

    # The bridge comes first: no server, no camera.
    bridge = programs.bridge("--hand", "robotiq-2f85", "--hand", "leap")
    until("discovery", lambda: user.goals.get_subscription_count() and user.cancels.get_subscription_count())
    until("the node's name", lambda: "graspd" in node.get_node_names())
    check("the node is there by its name", True)
    away = user.status(lambda s: s["server"]["state"] == "away")
    check("the server is away, and that is said", True, away["server"]["message"])
    errors = until("diagnostics", lambda: [d for d in list(user.came["diagnostics"]) if d.status[0].level == b"\x02"])
    check("diagnostics", errors[0].status[0].name == "graspd: server", errors[0].status[0].message)
    server = programs.server()
    user.status(lambda s: s["server"]["state"] == "up")
    check("the server is found when it comes", True)

    user.goal(id="early")
    early = user.result("early")
    check("a goal before an image is refused", early["reason"] == "NO_FRAME", early["message"])
    answer = user.call()
    check("and so is a call", not answer.success and "NO_FRAME" in answer.message)

    camera.running = True
    user.status(lambda s: s["frame"]["state"] == "ready")
    answer = user.call()
    result = json.loads(answer.message)
    check("Trigger answers with the result", answer.success)
    stamp = at_the_object("service", result, camera)
    published(user, result, stamp)
    named = node.create_client(Trigger, "/graspd/plan_grasps/leap")
    result = json.loads(user.call(named).message)
    at_the_object("service of a hand", result, camera)
    check("its hand", result["hand"] == "leap" and len(result["grasps"][0]["joints"]["names"]) == 16)

    # A goal, its feedback, and who comes later.
    user.goal(id="pick-1", hand="robotiq-2f85", max_grasps=3, budget_ms=30000)
    result = user.result("pick-1")
    stamp = at_the_object("goal", result, camera)
    feedback = [f for f in (json.loads(m.data) for m in list(user.came["feedback"])) if f["goal_id"] == "pick-1"]
    check("feedback", bool(feedback) and feedback[0]["phase"] == "accepted", str([f["phase"] for f in feedback]))
    camera.running = False
    late = defaultdict(list)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for kind, topic in [(PoseArray, "grasps"), (MarkerArray, "markers"), (JointState, "joint_state"), (String, "result")]:
        node.create_subscription(kind, f"/graspd/{topic}", late[topic].append, latched)
    until("latched messages", lambda: all(late[t] for t in ("grasps", "markers", "joint_state", "result")))
    check("who subscribes later gets the last plan", bool(of_stamp(late["grasps"], stamp)))
    camera.running = True

    # RViz: "Publish Point" on the box, beside it, and in a frame that is not the camera's.
    points = node.create_publisher(PointStamped, "/clicked_point", 10)
    until("points", points.get_subscription_count)

    def click(at, frame=FRAME):
        before = len(user.came["result"])
        message = PointStamped()
        message.header.frame_id = frame
        message.point.x, message.point.y, message.point.z = map(float, at)
        points.publish(message)
        return json.loads(until("a result of a point", lambda: list(user.came["result"])[before:])[0].data)

    at_the_object("clicked point", click(in_camera([0.0, 0.0, BOX[2]])), camera)
    nothing = click(in_camera([0.12, 0.08, 0.0]))
    check("a point on the bare table", nothing["state"] == "no_grasp", nothing["message"])
    empty = until("an empty plan", lambda: [p for p in list(user.came["grasps"]) if not p.poses])[-1]
    check("no grasp: empty poses in the image's frame", empty.header.frame_id == FRAME)
    cleared = until("a cleared picture", lambda: [a for a in list(user.came["markers"]) if len(a.markers) == 1])[-1]
    check("no grasp: markers are deleted", cleared.markers[0].action == Marker.DELETEALL)
    other = click([0.0, 0.0, 0.5], "base_link")
    check("a point of another frame", other["reason"] == "FRAME_MISMATCH", other["message"])

    # Wrong goals.
    user.goals.publish(String(data="{"))
    wrong = until("a refusal", lambda: [r for r in map(json.loads, (m.data for m in list(user.came["result"]))) if r["reason"] == "INVALID_GOAL"])
    check("a goal that is no JSON", wrong[0]["state"] == "refused", wrong[0]["message"])
    user.goal(id="odd", hand="no-such-hand")
    odd = user.result("odd")
    check("a hand that is not there", odd["reason"] == "HAND_NOT_FOUND", odd["message"])

    # Cancel.
    user.goal(id="long", batch=4096, iterations=10000)
    user.status(lambda s: any(g["id"] == "long" and g["phase"] != "waiting" for g in s["goals"]))
    until("a running job", running_jobs)
    began = time.monotonic()
    user.cancels.publish(String(data="long"))
    canceled = user.result("long")
    check("cancel", canceled["state"] == "canceled", f"answered after {time.monotonic() - began:.2f} s")
    until("an idle server", lambda: running_jobs() == 0)
    check("cancel: the server's work has ended", True, f"after {time.monotonic() - began:.2f} s")

    # The other encoding, and images that cannot be read.
    camera.metres_big_endian()
    swapped = len(camera.stamps)
    user.status(lambda s: (s["frame"]["stamp"]["sec"], s["frame"]["stamp"]["nanosec"]) in camera.stamps[swapped + 1 :])
    at_the_object("32FC1, big-endian, padded rows", json.loads(user.call().message), camera)
    camera.colours()
    user.status(lambda s: s["frame"].get("reason") == "INVALID_FRAME")
    refused = json.loads(user.call().message)
    check("an image without depth", refused["reason"] == "INVALID_FRAME", refused["message"])
    camera.millimetres()
    user.status(lambda s: s["frame"]["state"] == "ready")

    # The server dies while it plans, and comes back.
    user.goal(id="lost", batch=4096, iterations=10000)
    user.status(lambda s: any(g["id"] == "lost" and g["phase"] != "waiting" for g in s["goals"]))
    server.kill()
    server.wait()
    lost = user.result("lost")
    check("a server that dies", lost["state"] == "aborted" and lost["reason"] == "SERVER_AWAY", lost["message"])
    user.status(lambda s: s["server"]["state"] == "away")
    server = programs.server()
    user.status(lambda s: s["server"]["state"] == "up")
    at_the_object("after the server's return", json.loads(user.call().message), camera)

    # A second bridge, in a namespace, from a file, that wants labels.
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(
            f'server = "http://{SERVER}"\nhands = ["leap"]\nnamespace = "/cell"\nlabels = "/camera/labels"\n'
            "max_grasps = 2\nno_such_setting = 1\n"
        )
        file.flush()
        said = subprocess.run([programs.bridge_program, "--config", file.name], capture_output=True, text=True, timeout=60, check=False)
        check("a setting that is none", said.returncode == 1 and "no_such_setting" in said.stderr)
        file.seek(0)
        file.truncate()
        file.write(
            f'server = "http://{SERVER}"\nhands = ["leap"]\nnamespace = "/cell"\nlabels = "/camera/labels"\nmax_grasps = 2\n'
            'interfaces = ["127.0.0.1"]\n'
        )
        file.flush()
        second = programs.bridge("--config", file.name)
        other = User(node, "/cell/graspd")
        until("the second bridge", lambda: other.goals.get_subscription_count())
        other.status(lambda s: s["frame"]["state"] == "ready" and s["server"]["state"] == "up")
        other.goal(id="labelled", target_label=1)
        result = other.result("labelled")
        at_the_object("namespace, file, labels", result, camera)
        check("namespace: its hand, its limit", result["hand"] == "leap" and len(result["grasps"]) <= 2)
        check("labels", all(g["label"] == 1 for g in result["grasps"]))
        second.terminate()
        check("the second one ends", second.wait(PATIENCE) == 0)

    # Large images over best effort: how many arrive says how good the machine's buffers are; one must.
    camera.labels = None

    def arrived():
        """What has come when nothing more comes."""
        camera.running = False
        time.sleep(1.5)
        last = len(user.came["status"])
        until("a status", lambda: len(user.came["status"]) > last)
        return user.status(lambda s: True)["images"]

    before = arrived()
    camera.large()
    sent, camera.running = len(camera.stamps), True
    user.status(lambda s: s["frame"]["state"] == "ready" and s["images"] > before + 20)
    came, sent = arrived() - before, len(camera.stamps) - sent
    check("images of 1280 x 720", 0 < came <= sent, f"{came} of {sent} arrived")
    camera.running = True
    user.status(lambda s: s["frame"]["state"] == "ready")
    at_the_object("1280 x 720", json.loads(user.call().message), camera)

    # A goal under way when the bridge ends is told so.
    user.goal(id="last", batch=4096, iterations=10000)
    user.status(lambda s: any(g["id"] == "last" for g in s["goals"]))
    began = time.monotonic()
    bridge.send_signal(signal.SIGINT)
    check("the bridge ends", bridge.wait(PATIENCE) == 0, f"within {time.monotonic() - began:.1f} s")
    check("its last word on a goal", user.result("last")["reason"] == "STOPPING")
    check("its last status", user.status(lambda s: s["stopping"])["stopping"])
    executor.shutdown()
    print("all ok", flush=True)


programs = Programs(sys.argv[1], sys.argv[2])
try:
    main(programs)
finally:
    programs.end()
