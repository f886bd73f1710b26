"""Independent clients of Robotiq grippers against the emulated ones. Run by robotiq.sh."""

import subprocess
import sys
import time
from importlib.metadata import version


def check(what, found, expected):
    """Prints a line; ends everything when it is not so."""
    if found != expected:
        sys.exit(f"FAILED {what}: found {found!r}, expected {expected!r}")
    print(f"ok     {what}: {found!r}")


def near(what, found, expected, tolerance):
    """As check, for numbers that are measured."""
    if abs(found - expected) > tolerance:
        sys.exit(f"FAILED {what}: found {found!r}, expected {expected!r} within {tolerance}")
    print(f"ok     {what}: {found!r}")


def with_pyrobotiqgripper(arguments):
    """pyrobotiqgripper: pymodbus beneath, reads FC04, writes parts with FC16 and FC23."""
    import pyrobotiqgripper as rq

    gripper = rq.RobotiqGripper(**arguments)
    gripper.connect()
    gripper.activate()
    check("activated", gripper.isActivated(), True)
    gripper.move(200)
    check("position", gripper.position(), 200)
    check("object: none", int(gripper.objectDetection()), 3)
    gripper.move(40, speed=100, force=10)
    check("position", gripper.position(), 40)
    gripper.open()
    near("open", gripper.position(), 3, 1)
    gripper.disconnect()


def with_pyrobotiqur(address):
    """pyRobotiqUR: the wrist socket."""
    from pyrobotiqur import RobotiqGripper

    host, port = address.rsplit(":", 1)
    gripper = RobotiqGripper(host, port=int(port))
    gripper.connect()
    gripper.reset()
    check("reset", gripper.get_status().name, "RESET")
    gripper.activate()
    check("active", gripper.get_status().name, "ACTIVE")
    position, found = gripper.move(150)
    check("move", (position, int(found)), (150, 3))
    check("fault", gripper.get_fault(), 0)
    position, found = gripper.open()
    near("open", position, 3, 1)
    gripper.disconnect()


def with_minimalmodbus(path, registers):
    """minimalmodbus: registers, of either function code; single and many."""
    import minimalmodbus

    slave = minimalmodbus.Instrument(path, 9)
    slave.serial.baudrate = 115200
    slave.serial.timeout = 0.5
    slave.clear_buffers_before_each_transaction = True
    holding = slave.read_registers(2000, registers, functioncode=3)
    check("FC03 and FC04 read the same", slave.read_registers(2000, registers, functioncode=4), holding)
    slave.write_register(1000, 0, functioncode=6)
    time.sleep(0.1)
    check("reset with FC06", slave.read_register(2000) >> 8 & 0x31, 0)
    slave.write_registers(1000, [0x0100, 0, 0])
    until = time.monotonic() + 20
    while slave.read_register(2000) >> 12 & 3 != 3 and time.monotonic() < until:
        time.sleep(0.05)
    check("activated with FC16", slave.read_register(2000) >> 12 & 3, 3)
    try:
        slave.read_register(3000)
        sys.exit("FAILED a register that is not there was read")
    except minimalmodbus.IllegalRequestError as error:
        print(f"ok     no such register: {error}")
    return slave


class Emulator:
    """The example binary; its servers by name."""

    def __init__(self, *command):
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.at = {}
        for line in self.process.stdout:
            if line.strip() == "ready":
                break
            name, where = line.split()
            self.at[name] = where

    def say(self, text):
        """What befalls the gripper: see the example."""
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()

    def __enter__(self):
        return self.at

    def __exit__(self, *_):
        self.process.stdin.close()
        self.process.wait(timeout=10)


def main():
    emulator = sys.argv[1]
    with Emulator(emulator, "2f") as at:
        print("pyrobotiqgripper", version("pyrobotiqgripper"), "RTU")
        with_pyrobotiqgripper({"com_port": at["rtu"]})
        print("pyrobotiqgripper", version("pyrobotiqgripper"), "RTU over TCP")
        host, port = at["rtu_over_tcp"].rsplit(":", 1)
        with_pyrobotiqgripper(
            {"connection_type": "RTU_VIA_TCP", "tcp_host": host, "tcp_port": int(port)}
        )
        print("pyRobotiqUR", version("pyrobotiqur"))
        with_pyrobotiqur(at["socket"])
        print("minimalmodbus", version("minimalmodbus"), "2F")
        with_minimalmodbus(at["rtu"], 3)
    with Emulator(emulator, "3f") as at:
        print("minimalmodbus", version("minimalmodbus"), "3F: registers")
        with_minimalmodbus(at["rtu"], 8)
    print("all ok")


if __name__ == "__main__":
    main()
