#!/usr/bin/env python3
"""A program of Unitree's Python SDK drives our world, over CycloneDDS.

    python3 tests/oracle/unitree.py SIM_SERVER [ADDRESS]

`sim-server` is built with its feature `unitree`; Python has `cyclonedds`, `numpy` and Unitree's SDK. It asks the motion switcher, reads
states and compares their checksums with the SDK's own, commands all motors for some seconds, and grades what came of it.
"""

import pathlib
import subprocess
import sys
import tempfile
import time

from unitree_sdk2py.comm.motion_switcher.motion_switcher_client import MotionSwitcherClient
from unitree_sdk2py.core.channel import ChannelFactoryInitialize, ChannelPublisher, ChannelSubscriber
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowCmd_
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_
from unitree_sdk2py.utils.crc import CRC

MOTORS = 29
DOMAIN = 7
# N m/rad and N m s/rad of a robot that holds its posture, by motor.
STIFFNESS = [150, 150, 150, 200, 40, 40] * 2 + [250] * 3 + [100] * 14
DAMPING = [2, 2, 2, 4, 2, 2] * 2 + [5] * 3 + [5] * 14


def main():
    server, address = sys.argv[1], (sys.argv[2:] or ["127.0.0.1"])[0]
    bags = pathlib.Path(tempfile.mkdtemp())
    flags = ["--unitree", "--domain", str(DOMAIN), "--dds-address", address, "--lockstep", "--record", str(bags)]
    running = subprocess.Popen([server, *flags, "--task", "S07"], stdout=subprocess.PIPE, text=True)
    running.stdout.readline()

    ChannelFactoryInitialize(DOMAIN, "lo" if address == "127.0.0.1" else None)
    switcher = MotionSwitcherClient()
    switcher.SetTimeout(10.0)
    switcher.Init()
    code, mode = switcher.CheckMode()
    assert code == 0 and mode["name"] == "", (code, mode)
    assert switcher.ReleaseMode()[0] == 0

    states = []
    subscriber = ChannelSubscriber("rt/lowstate", LowState_)
    subscriber.Init(states.append, 10)
    deadline = time.monotonic() + 20
    while len(states) < 100:
        assert time.monotonic() < deadline, f"{len(states)} states"
        time.sleep(0.01)
    checksum = CRC()
    assert all(state.crc == checksum.Crc(state) for state in states)
    first = states[-1]
    assert first.mode_machine == 5 and abs(first.imu_state.accelerometer[2] - 9.81) < 1.0

    publisher = ChannelPublisher("rt/lowcmd", LowCmd_)
    publisher.Init()
    command = unitree_hg_msg_dds__LowCmd_()
    command.mode_machine = first.mode_machine
    for motor in range(MOTORS):
        target = command.motor_cmd[motor]
        target.mode, target.q = 1, first.motor_state[motor].q
        target.kp, target.kd = STIFFNESS[motor], DAMPING[motor]
    # A command with a wrong checksum moves nothing: the episode begins with the first sound one.
    command.crc = checksum.Crc(command) ^ 1
    for _ in range(100):
        publisher.Write(command)
        time.sleep(0.002)
    assert states[-1].tick < 20, states[-1].tick
    # Without balance the robot falls within some seconds, which ends the episode.
    command.crc = checksum.Crc(command)
    deadline = time.monotonic() + 60
    while running.poll() is None:
        assert time.monotonic() < deadline, states[-1].tick
        publisher.Write(command)
        time.sleep(0.002)
    said = running.stdout.read()
    assert running.returncode == 0 and "ended after" in said, said
    (bag,) = bags.glob("*.mcap")
    print(f"{len(states)} states, {said.strip()}, {bag.stat().st_size} bytes")


if __name__ == "__main__":
    main()
