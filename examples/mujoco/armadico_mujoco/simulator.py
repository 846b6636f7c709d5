"""The controller of the simulated robot: the driver's protocol from the other end."""

from __future__ import annotations

import numpy as np

from armadico.bridge.simulator.encoders import TICKS_PER_M
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.streaming import StreamingController
from armadico_mujoco import driver
from armadico_mujoco.kind import MujocoRobot


class Firmware(StreamingController):
    """It sends a frame each cycle, and stops by its watchdog."""

    def __init__(self, profile: MujocoRobot, plant: Plant) -> None:
        super().__init__(plant, profile.cycle_s, profile.mujoco.watchdog_s)
        self._scale = profile.mujoco.counts_per_m / TICKS_PER_M

    def obey(self, received: bytearray) -> bool:
        length = len(driver.COMMAND) + driver.SPEEDS.size + 2
        if len(received) < length:
            return False
        data = bytes(received[:length])
        if not data.startswith(driver.COMMAND) or driver.checksum(data[:-2]) != data[-2:]:
            del received[0]
            return True
        del received[:length]
        v, w, streams = driver.SPEEDS.unpack_from(data, len(driver.COMMAND))
        self.drive(v / 1000, w / 1000)
        self.stream(bool(streams))
        return True

    def frame(self) -> bytes:
        plant = self.plant
        left, right = (round(ticks * self._scale) & 0xFFFF for ticks in plant.encoder_counts)
        mm = np.rint(1000.0 * np.nan_to_num(plant.scan(), posinf=0.0)).astype(np.uint16)
        flags = driver.BUMPED * self.bumped | driver.CHARGING * plant.battery.charging
        ranges = np.where(mm == 0, driver.NOTHING_MM, mm)
        return driver.encode(
            driver.Frame(left, right, round(1000 * plant.battery.volts), flags, ranges)
        )
