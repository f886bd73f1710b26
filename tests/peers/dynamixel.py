"""Independent clients of the Dynamixel protocol against the emulated bus. Run by dynamixel.sh."""

import math
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path


def check(what, found, expected):
    """Prints a line; ends everything when it is not so."""
    if found != expected:
        sys.exit(f"FAILED {what}: found {found!r}, expected {expected!r}")
    print(f"ok     {what}: {found!r}")


def with_sdk(path):
    """The manufacturer's SDK: every instruction of protocol 2.0 that a hand needs."""
    from dynamixel_sdk import (
        COMM_RX_TIMEOUT,
        COMM_SUCCESS,
        GroupBulkRead,
        GroupSyncRead,
        GroupSyncWrite,
        PacketHandler,
        PortHandler,
    )

    print("dynamixel-sdk", version("dynamixel-sdk"))
    port = PortHandler(path)
    check("open", port.openPort(), True)
    check("baud rate", port.setBaudRate(4_000_000), True)
    packet = PacketHandler(2.0)
    check("ping", packet.ping(port, 1), (1240, COMM_SUCCESS, 0))
    found, result = packet.broadcastPing(port)
    check("broadcast ping", (sorted(found), result), (list(range(16)), COMM_SUCCESS))
    check("silent motor", packet.ping(port, 77)[1], COMM_RX_TIMEOUT)

    for motor in range(16):
        check(f"mode of {motor}", packet.write1ByteTxRx(port, motor, 11, 5), (COMM_SUCCESS, 0))
        check(f"torque of {motor}", packet.write1ByteTxRx(port, motor, 64, 1), (COMM_SUCCESS, 0))
    check("mode while torque is on: access error", packet.write1ByteTxRx(port, 0, 11, 3), (COMM_SUCCESS, 7))
    check("current above its limit: limit error", packet.write2ByteTxRx(port, 0, 102, 3000), (COMM_SUCCESS, 6))
    check("read-only register: access error", packet.write4ByteTxRx(port, 0, 132, 0), (COMM_SUCCESS, 7))

    goals = {motor: 2048 + 10 * motor for motor in range(16)}
    write = GroupSyncWrite(port, packet, 116, 4)
    for motor, goal in goals.items():
        write.addParam(motor, goal.to_bytes(4, "little"))
    check("sync write", write.txPacket(), COMM_SUCCESS)
    time.sleep(0.5)
    for name in ("sync read", "fast sync read"):
        read = GroupSyncRead(port, packet, 126, 10)
        for motor in goals:
            read.addParam(motor)
        began = time.perf_counter()
        result = read.fastSyncRead() if name.startswith("fast") else read.txRxPacket()
        took = time.perf_counter() - began
        check(name, result, COMM_SUCCESS)
        positions = {motor: read.getData(motor, 132, 4) for motor in goals}
        check(f"{name}: positions ({took * 1e3:.1f} ms)", positions, goals)
    bulk = GroupBulkRead(port, packet)
    bulk.addParam(3, 132, 4)
    bulk.addParam(5, 146, 1)
    check("bulk read", bulk.txRxPacket(), COMM_SUCCESS)
    check("bulk read: values", (bulk.getData(3, 132, 4), bulk.getData(5, 146, 1)), (goals[3], 30))

    check("torque off", packet.write1ByteTxRx(port, 2, 64, 0), (COMM_SUCCESS, 0))
    check("stuffed write", packet.write4ByteTxRx(port, 2, 116, 0x00FDFFFF), (COMM_SUCCESS, 0))
    check("stuffed read", packet.read4ByteTxRx(port, 2, 116), (0x00FDFFFF, COMM_SUCCESS, 0))
    check("staged write", packet.regWriteTxRx(port, 4, 65, 1, [1]), (COMM_SUCCESS, 0))
    check("not yet done", packet.read1ByteTxRx(port, 4, 65)[0], 0)
    check("action", packet.action(port, 4), COMM_SUCCESS)
    time.sleep(0.05)
    port.clearPort()
    check("done", packet.read1ByteTxRx(port, 4, 65)[0], 1)
    check("reboot", packet.reboot(port, 2), (COMM_SUCCESS, 0))
    check("silent while it boots", packet.ping(port, 2)[1], COMM_RX_TIMEOUT)
    time.sleep(0.4)
    check("back, torque off", packet.read1ByteTxRx(port, 2, 64), (0, COMM_SUCCESS, 0))
    port.closePort()


def with_rustypot(path):
    """rustypot: another implementation, in Rust, of another maker."""
    from rustypot import Xl330PyController

    print("rustypot", version("rustypot"))
    controller = Xl330PyController(path, 4_000_000, 0.2)
    check("ping", controller.ping(0), True)
    ids = [0, 7, 15]
    controller.sync_write_torque_enable(ids, [True] * 3)
    check("torque", controller.sync_read_torque_enable(ids), [True] * 3)
    goals = [0.1, 0.2, -0.3]
    controller.sync_write_goal_position(ids, goals)
    time.sleep(0.5)
    found = controller.sync_read_present_position(ids)
    near = [math.isclose(a, b, abs_tol=0.002) for a, b in zip(found, goals)]
    check(f"positions {[round(x, 4) for x in found]}", near, [True] * 3)
    check("temperature", controller.sync_read_present_temperature(ids), [30, 30, 30])


def main():
    path = str(Path(tempfile.mkdtemp()) / "bus")
    emulator = subprocess.Popen(
        [sys.argv[1], path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        check("emulator", emulator.stdout.readline().strip(), path)
        with_sdk(path)
        with_rustypot(path)
    finally:
        emulator.stdin.close()
        emulator.wait(timeout=10)
    print("all ok")


main()
