"""A 3-Finger gripper by its register table, with two independent Modbus libraries as master, against the emulated one. Run by
robotiq.sh.

No client of this gripper is to be had ready-made. What bytes mean is written down here from the manufacturer's table; nothing
is taken from our adapter. minimalmodbus and pymodbus make the frames, over RTU (registers 1000 and 2000) and TCP (registers
from 0).
"""

import sys
import time
from importlib.metadata import version

from robotiq import Emulator, check

BASIC, PINCH, WIDE, SCISSOR = range(4)
# gIMC: reset, activating, changing mode, done.
RESET, ACTIVATING, CHANGING, READY = range(4)
# gDTA and the like: moving, met something while opening, while closing, at the position.
MOVING, MET_OPENING, MET_CLOSING, REACHED = range(4)


class Minimal:
    """minimalmodbus on a serial line."""

    inputs, outputs, kinds = 2000, 1000, (3, 4)

    def __init__(self, at):
        import minimalmodbus

        self.slave = minimalmodbus.Instrument(at["rtu"], 9)
        self.slave.serial.baudrate = 115200
        self.slave.serial.timeout = 1.0
        self.slave.clear_buffers_before_each_transaction = True

    def read(self, kind):
        return self.slave.read_registers(self.inputs, 8, functioncode=kind)

    def write(self, words):
        self.slave.write_registers(self.outputs, words)

    def close(self):
        self.slave.serial.close()


class Serial:
    """pymodbus on a serial line."""

    inputs, outputs, kinds = 2000, 1000, (3, 4)

    def __init__(self, at):
        self.connect(at)
        if not self.client.connect():
            sys.exit("FAILED pymodbus does not connect")

    def connect(self, at):
        from pymodbus import FramerType
        from pymodbus.client import ModbusSerialClient

        self.client = ModbusSerialClient(at["rtu"], framer=FramerType.RTU, baudrate=115200, timeout=1)

    def read(self, kind):
        ask = self.client.read_holding_registers if kind == 3 else self.client.read_input_registers
        answer = ask(self.inputs, count=8, device_id=9)
        if answer.isError():
            sys.exit(f"FAILED read with function code {kind}: {answer}")
        return answer.registers

    def write(self, words):
        answer = self.client.write_registers(self.outputs, words, device_id=9)
        if answer.isError():
            sys.exit(f"FAILED write: {answer}")

    def close(self):
        self.client.close()


class Tcp(Serial):
    """pymodbus over TCP, where registers count from 0."""

    inputs, outputs, kinds = 0, 0, (4,)

    def connect(self, at):
        from pymodbus.client import ModbusTcpClient

        host, port = at["modbus_tcp"].rsplit(":", 1)
        self.client = ModbusTcpClient(host, port=int(port), timeout=1)


class ThreeFinger:
    """The gripper's sixteen bytes each way, by the table."""

    def __init__(self, link):
        self.link = link

    def write(self, *, active=1, mode=BASIC, go=0, alone=0, fingers=((0, 255, 255),) * 3, scissor=None):
        scissor = scissor or (0, 255, 255)
        first = active | mode << 1 | go << 3
        # rICF and rICS: each finger, and the scissor, alone.
        second = 0b1100 if alone else 0
        request = [first, second, 0, *fingers[0], *fingers[1], *fingers[2], *scissor, 0]
        self.link.write([request[i] << 8 | request[i + 1] for i in range(0, 16, 2)])

    def status(self):
        words = [self.link.read(kind) for kind in self.link.kinds]
        b = [byte for word in words[-1] for byte in (word >> 8, word & 0xFF)]
        return {
            "active": b[0] & 1,
            "mode": b[0] >> 1 & 3,
            "goes": b[0] >> 3 & 1,
            "phase": b[0] >> 4 & 3,
            "stopped": b[0] >> 6 & 3,
            "met": [b[1] >> 2 * i & 3 for i in range(4)],
            "fault": b[2] & 0xF,
            "asked": [b[3 + 3 * i] for i in range(4)],
            "at": [b[4 + 3 * i] for i in range(4)],
        }

    def until(self, what, condition, seconds=40.0):
        end = time.monotonic() + seconds
        while True:
            status = self.status()
            if condition(status):
                return status
            if time.monotonic() > end:
                sys.exit(f"FAILED never {what}: {status}")
            time.sleep(0.02)

    def rests(self, asked):
        """Where it stands once it has taken the request and no axis moves."""
        def still(s):
            return s["asked"] == asked and s["stopped"] != 0 and MOVING not in s["met"]

        return self.until(f"at rest after {asked}", still)


def drive(link, emulator):
    """Through the table: activation, a mode, each finger alone, objects, a fault."""
    gripper = ThreeFinger(link)
    gripper.write(active=0)
    status = gripper.until("reset", lambda s: s["phase"] == RESET)
    check("reset", (status["active"], status["mode"]), (0, BASIC))
    gripper.write()
    gripper.until("activating", lambda s: s["phase"] == ACTIVATING)
    status = gripper.until("ready", lambda s: s["phase"] == READY)
    check("activated", (status["active"], status["mode"], status["fault"]), (1, BASIC, 0))

    # All fingers by finger A's request.
    together = ((100, 255, 128), (0, 0, 0), (0, 0, 0))
    gripper.write(go=1, fingers=together)
    status = gripper.until("closed together", lambda s: s["at"][:3] == [100] * 3 and s["stopped"] == 3)
    check("closed together", (status["at"][:3], status["met"][:3]), ([100] * 3, [REACHED] * 3))

    gripper.write(mode=PINCH)
    gripper.until("changing mode", lambda s: s["phase"] == CHANGING)
    status = gripper.until("in pinch mode", lambda s: s["phase"] == READY)
    check("pinch mode", status["mode"], PINCH)

    def alone(a, b, c, s):
        fingers = tuple((count, 255, 255) for count in (a, b, c))
        gripper.write(mode=PINCH, go=1, alone=1, fingers=fingers, scissor=(s, 255, 255))
        return gripper.rests([a, b, c, s])

    status = alone(60, 90, 120, 30)
    check("each alone", (status["at"], status["met"], status["stopped"]), ([60, 90, 120, 30], [REACHED] * 4, 3))
    alone(0, 0, 0, 30)
    emulator.say("object 1 80")
    status = alone(150, 150, 150, 30)
    check("finger B meets something", (status["met"], status["stopped"]), ([REACHED, MET_CLOSING, REACHED, REACHED], 1))
    check("where it was met", status["at"][1], 80)
    alone(0, 0, 0, 30)
    for axis in (0, 2):
        emulator.say(f"object {axis} 80")
    status = alone(150, 150, 150, 30)
    check("all meet something", (status["met"][:3], status["stopped"]), ([MET_CLOSING] * 3, 2))
    check("where they were met", status["at"][:3], [80] * 3)

    emulator.say("fault 13")
    status = gripper.until("a fault", lambda s: s["fault"] == 0xD)
    for axis in range(3):
        emulator.say(f"object {axis} none")
    gripper.write(active=0)
    gripper.until("reset again", lambda s: s["phase"] == RESET and s["fault"] == 0)
    gripper.write()
    status = gripper.until("ready again", lambda s: s["phase"] == READY)
    check("activated again", (status["active"], status["fault"]), (1, 0))
    link.close()


def main():
    for name, link in (
        (f"minimalmodbus {version('minimalmodbus')} RTU", Minimal),
        (f"pymodbus {version('pymodbus')} RTU", Serial),
        (f"pymodbus {version('pymodbus')} TCP", Tcp),
    ):
        emulator = Emulator(sys.argv[1], "3f")
        with emulator as at:
            print(name, "3F")
            drive(link(at), emulator)
    print("all ok")


main()
