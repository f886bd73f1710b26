"""An independent Modbus slave (pymodbus) that plays a Robotiq 2F or 3-Finger, for our master. Run by robotiq.sh.

    modbus_slave.py rtu|tcp [2f|3f]

Prints where our master finds it: a serial port, or an address.

pymodbus does the protocol; the few lines of gripper here only move registers.
"""

import asyncio
import os
import sys
import threading
import tty

from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

STATE = {"count": 60.0}


def status(request):
    """Three status registers of a gripper that was asked this."""
    action, position = request[0] >> 8, request[1] & 0xFF
    active, goes = action & 1, action >> 3 & 1
    moving = 0
    if active and goes:
        target = min(max(position, 3), 230)
        way = target - STATE["count"]
        STATE["count"] += max(-12, min(12, way))
        moving = abs(target - STATE["count"]) > 0.5
    phase = 3 if active else 0
    done = 0 if moving or not goes else 3
    first = active | goes << 3 | phase << 4 | done << 6
    return [first << 8, position, round(STATE["count"]) << 8]


# A 3-Finger: where its axes A, B, C and scissor are, and since when it changes what.
THREE = {"at": [0.0, 0.0, 0.0, 140.0], "mode": 0, "phase": 0, "left": 0}
# Finger B meets something there.
OBJECT_AT = 80


def status_of_three_fingers(words):
    """Eight status registers of a 3-Finger that was asked this, by the manufacturer's table."""
    request = [byte for word in words for byte in (word >> 8, word & 0xFF)]
    active, mode, goes = request[0] & 1, request[0] >> 1 & 3, request[0] >> 3 & 1
    if not active:
        THREE.update(phase=0, mode=0, left=0)
    elif THREE["phase"] == 0:
        THREE.update(phase=1, left=5)
    elif THREE["phase"] == 3 and mode != THREE["mode"] and not request[1]:
        THREE.update(phase=2, left=5)
    elif THREE["left"] > 0:
        THREE["left"] -= 1
    elif THREE["phase"] in (1, 2):
        THREE.update(phase=3, mode=mode)
    asked = [request[3 + 3 * i] for i in range(4)]
    alone_fingers, alone_scissor = request[1] >> 2 & 1, request[1] >> 3 & 1
    if not alone_fingers:
        asked[1] = asked[2] = asked[0]
    if not alone_scissor:
        asked[3] = round(THREE["at"][3])
    met, moving = [3] * 4, False
    for i in range(4):
        ends = (asked[i], OBJECT_AT) if i == 1 and asked[i] > OBJECT_AT else (asked[i],)
        target = min(ends)
        if goes and THREE["phase"] == 3:
            way = target - THREE["at"][i]
            THREE["at"][i] += max(-25, min(25, way))
        if abs(target - THREE["at"][i]) > 0.5:
            met[i], moving = 0, True
        elif target != asked[i]:
            met[i] = 2
    held = met[:3].count(2)
    stopped = 0 if moving or not goes else 3 if held == 0 else 2 if held == 3 else 1
    first = active | THREE["mode"] << 1 | goes << 3 | THREE["phase"] << 4 | stopped << 6
    second = sum(bits << 2 * i for i, bits in enumerate(met))
    answer = [first, second, 0]
    for i in range(4):
        answer += [asked[i], round(THREE["at"][i]), 5 * (met[i] == 2)]
    answer.append(0)
    return [answer[i] << 8 | answer[i + 1] for i in range(0, 16, 2)]


def device(three, from_zero):
    """A device whose status follows its request whenever it is read."""
    count = 8 if three else 3
    written = [0] * count
    outputs, inputs = (0, 0) if from_zero else (1000, 2000)
    answer = status_of_three_fingers if three else status

    async def action(_function, start, address, _count, registers, values):
        if values is not None:
            for i, value in enumerate(values):
                written[address - outputs + i] = value
        else:
            at = inputs - start
            registers[at : at + count] = answer(written)

    registers = SimData(outputs, count=inputs - outputs + count, values=0, datatype=DataType.REGISTERS)
    return SimDevice(9, simdata=[registers], action=action)


def line():
    """Two pseudo-terminals, joined: what is written to one comes out of the other."""
    ends = [os.openpty() for _ in range(2)]
    for _, clients in ends:
        tty.setraw(clients)

    def pump(here, there):
        while True:
            os.write(there, os.read(here, 4096))

    for here, there in ((0, 1), (1, 0)):
        threading.Thread(target=pump, args=(ends[here][0], ends[there][0]), daemon=True).start()
    return [os.ttyname(clients) for _, clients in ends]


async def main():
    three = sys.argv[2:] == ["3f"]
    if sys.argv[1] == "rtu":
        ours, theirs = line()
        server = ModbusSerialServer(device(three, False), framer=FramerType.RTU, port=ours, baudrate=115200)
        print(f"rtu:{theirs}", flush=True)
    else:
        server = ModbusTcpServer(device(three, three), address=("127.0.0.1", 5021))
        print("tcp:127.0.0.1:5021", flush=True)
    await server.serve_forever()


asyncio.run(main())
