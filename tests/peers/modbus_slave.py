"""An independent Modbus slave (pymodbus) that plays a Robotiq 2F, for our master. Run by robotiq.sh.

    modbus_slave.py rtu | tcp

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


def device():
    """A device whose status follows its request whenever it is read."""
    written = [0, 0, 0]

    async def action(_function, start, address, _count, registers, values):
        if values is not None:
            for i, value in enumerate(values):
                written[address - 1000 + i] = value
        else:
            at = 2000 - start
            registers[at : at + 3] = status(written)

    registers = SimData(1000, count=1003, values=0, datatype=DataType.REGISTERS)
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
    if sys.argv[1] == "rtu":
        ours, theirs = line()
        server = ModbusSerialServer(device(), framer=FramerType.RTU, port=ours, baudrate=115200)
        print(f"rtu:{theirs}", flush=True)
    else:
        server = ModbusTcpServer(device(), address=("127.0.0.1", 5021))
        print("tcp:127.0.0.1:5021", flush=True)
    await server.serve_forever()


asyncio.run(main())
