"""Independent clients against the emulated Universal Robots controller.

ur_rtde (receive, IO, dashboard, script, control) and universal-robots-clients (dashboard, RTDE registers). Every
answer is checked; the first that is wrong ends the run. Usage: ur_peers.py ADDRESS
"""

import importlib.metadata
import math
import sys
import time

import dashboard_client
import rtde_control
import rtde_io
import rtde_receive
import script_client
from universal_robots_clients import dashboard_client as urc_dashboard
from universal_robots_clients import rtde_client as urc_rtde


def check(what: str, good: bool, found: object = "") -> None:
    print(("ok   " if good else "WRONG"), what, found, flush=True)
    if not good:
        sys.exit(1)


def near(a: list[float], b: list[float], tolerance: float) -> bool:
    return max(abs(x - y) for x, y in zip(a, b)) < tolerance


def eventually(condition, seconds: float = 5.0) -> bool:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if condition():
            return True
        time.sleep(0.01)
    return False


def receive(host: str) -> None:
    client = rtde_receive.RTDEReceiveInterface(host)
    check("receive: connected", client.isConnected())
    check("receive: RUNNING, NORMAL", (client.getRobotMode(), client.getSafetyMode()) == (7, 1))
    stamps = set()
    until = time.monotonic() + 1.0
    while time.monotonic() < until:
        stamps.add(client.getTimestamp())
        time.sleep(0.0005)
    check("receive: frames a second at 500 Hz", len(stamps) > 100, len(stamps))
    check("receive: six joints", len(client.getActualQ()) == 6, client.getActualQ())
    client.disconnect()
    slow = rtde_receive.RTDEReceiveInterface(host, 125.0, ["timestamp", "actual_q"])
    check("receive: recipe of its own at 125 Hz", eventually(lambda: slow.getTimestamp() > 0))
    slow.disconnect()


def dashboard(host: str) -> None:
    client = dashboard_client.DashboardClient(host)
    client.connect()
    check("dashboard: connected", client.isConnected())
    check("dashboard: mode", client.robotmode() == "Robotmode: RUNNING", client.robotmode())
    check("dashboard: safety", client.safetystatus() == "Safetystatus: NORMAL", client.safetystatus())
    check("dashboard: version", client.polyscopeVersion().startswith("5.17"), client.polyscopeVersion())
    check("dashboard: remote control", client.isInRemoteControl())
    client.loadURP("peer.urp")
    client.play()
    check("dashboard: playing", client.running() and "PLAYING" in client.programState(), client.programState())
    client.pause()
    client.stop()
    check("dashboard: stopped", eventually(lambda: not client.running()))
    client.powerOff()
    check("dashboard: power off", eventually(lambda: "POWER_OFF" in client.robotmode()))
    client.powerOn()
    check("dashboard: power on", eventually(lambda: "IDLE" in client.robotmode()))
    client.brakeRelease()
    check("dashboard: brakes released", eventually(lambda: "RUNNING" in client.robotmode()))
    client.closeSafetyPopup()
    client.unlockProtectiveStop()
    client.quit()


def io(host: str) -> None:
    reader = rtde_receive.RTDEReceiveInterface(host)
    client = rtde_io.RTDEIOInterface(host)
    check("io: digital output", client.setStandardDigitalOut(3, True))
    check("io: digital output seen", eventually(lambda: reader.getDigitalOutState(3)))
    check("io: slider", client.setSpeedSlider(0.5))
    check("io: slider seen", eventually(lambda: abs(reader.getTargetSpeedFraction() - 0.5) < 1e-9))
    check("io: register", client.setInputIntRegister(20, 42))
    client.setSpeedSlider(1.0)
    check("io: slider back", eventually(lambda: abs(reader.getTargetSpeedFraction() - 1.0) < 1e-9))
    client.disconnect()
    reader.disconnect()


def script(host: str) -> None:
    reader = rtde_receive.RTDEReceiveInterface(host)
    client = script_client.ScriptClient(host, 5, 17)
    client.connect()
    check("script: connected", client.isConnected())
    program = "def peer():\n  write_output_integer_register(13, 77)\n  sleep(0.3)\nend\n"
    check("script: sent", client.sendScriptCommand(program))
    check("script: ran", eventually(lambda: reader.getOutputIntRegister(13) == 77))
    client.disconnect()
    reader.disconnect()


def control(host: str) -> None:
    reader = rtde_receive.RTDEReceiveInterface(host)
    client = rtde_control.RTDEControlInterface(host)
    check("control: program runs", client.isProgramRunning())
    home = reader.getActualQ()
    goal = list(home)
    goal[0] += 0.3
    goal[3] -= 0.2
    check("control: moveJ", client.moveJ(goal, 1.0, 2.0))
    check("control: moveJ arrived", near(reader.getActualQ(), goal, 1e-3), reader.getActualQ())
    pose = reader.getActualTCPPose()
    up = list(pose)
    up[2] += 0.05
    check("control: moveL", client.moveL(up, 0.25, 1.0))
    check("control: moveL arrived", near(reader.getActualTCPPose()[:3], up[:3], 1e-3), reader.getActualTCPPose())
    # Not with arguments: ur_rtde 1.6.5 sends those as 12 numbers under a recipe that it declared with 6.
    flange = client.getForwardKinematics()
    check("control: forward kinematics", near(flange[:3], reader.getActualTCPPose()[:3], 1e-3), flange)
    here = reader.getActualQ()
    joints = client.getInverseKinematics(flange, here)
    check("control: inverse of forward", near(joints, here, 1e-3), joints)
    check("control: moveJ_IK", client.moveJ_IK(pose, 1.0, 2.0))
    check("control: moveJ_IK arrived", near(reader.getActualTCPPose()[:3], pose[:3], 1e-3))
    target = reader.getActualQ()
    for _ in range(200):
        start = client.initPeriod()
        target[5] += 0.001
        check_quiet(client.servoJ(target, 0.0, 0.0, 0.002, 0.1, 300.0))
        client.waitPeriod(start)
    check("control: servoJ 200 times", True)
    check("control: servoJ follows", eventually(lambda: abs(reader.getActualQ()[5] - target[5]) < 0.02), (
        reader.getActualQ()[5], target[5]))
    check("control: servoStop", client.servoStop())
    check("control: speedL", client.speedL([0.0, 0.0, -0.03, 0.0, 0.0, 0.0], 0.5, 0.0))
    time.sleep(0.3)
    check("control: speedL moves", reader.getActualTCPSpeed()[2] < -0.02, reader.getActualTCPSpeed()[2])
    check("control: speedStop", client.speedStop())
    check("control: stands", eventually(lambda: max(map(abs, reader.getActualQd())) < 1e-3))
    check("control: asynchronous moveJ", client.moveJ(home, 0.3, 1.0, True))
    check("control: moves", eventually(lambda: max(map(abs, reader.getActualQd())) > 0.05))
    client.stopJ(2.0)
    check("control: stopJ", eventually(lambda: max(map(abs, reader.getActualQd())) < 1e-3))
    check("control: before its goal", not near(reader.getActualQ(), home, 1e-2))
    check("control: steady", eventually(client.isSteady))
    path = [home + [0.5, 1.0, 0.0], goal + [0.5, 1.0, 0.0]]
    check("control: path of two moves", client.moveJ(path))
    check("control: path arrived", near(reader.getActualQ(), goal, 2e-3), reader.getActualQ())
    try:
        client.servoJ(goal, 0.0, 0.0, 0.002, 0.5, 300.0)
        check("control: a lookahead out of range is refused", False)
    except ValueError as error:
        check("control: a lookahead out of range is refused", "0.03" in str(error))
    client.stopScript()
    check("control: script ended", eventually(lambda: not client.isProgramRunning()))
    client.disconnect()
    reader.disconnect()


def check_quiet(good: bool) -> None:
    if not good:
        check("control: servoJ", False)


def universal_robots_clients(host: str) -> None:
    check("urc: state", "STOPPED" in urc_dashboard.get_program_state(host), urc_dashboard.get_program_state(host))
    check("urc: mode", urc_dashboard.send_command(host, "robotmode") == "Robotmode: RUNNING")
    check("urc: load", urc_dashboard.load_program(host, "a.urp") == "Loading program: /programs/a.urp")
    check("urc: play", urc_dashboard.play_program(host) == "Starting program")
    check("urc: stop", urc_dashboard.stop_program(host) == "Stopped")
    client = urc_rtde.connect(host)
    check("urc: connected", urc_rtde.is_connected(client))
    joints = urc_rtde.read_actual_joint_positions(client)
    check("urc: joints", len(joints) == 6 and all(map(math.isfinite, joints)), joints)
    check("urc: mode", urc_rtde.read_robot_mode(client) == 7)
    check("urc: no stop", not urc_rtde.is_protective_stopped(client) and not urc_rtde.is_emergency_stopped(client))
    urc_rtde.write_input_int_register(42, 4711, client=client)
    urc_rtde.write_input_double_register(43, 2.5, client=client)
    urc_rtde.write_tool_digital_output(0, True, client=client)
    check("urc: tool output", eventually(lambda: urc_rtde.read_tool_digital_output(0, client=client)))
    check("urc: registers out", urc_rtde.read_output_int_register(42, client=client) == 0)
    urc_rtde.disconnect(client)


def main() -> None:
    host = sys.argv[1]
    for package in ("ur_rtde", "universal-robots-clients"):
        print(package, importlib.metadata.version(package))
    only = sys.argv[2:]
    for part in (receive, dashboard, io, script, control, universal_robots_clients):
        if not only or part.__name__ in only:
            part(host)
    print("all peers agree")


if __name__ == "__main__":
    main()
