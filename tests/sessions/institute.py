"""Rooms of institute.osm to which people are led, each with its one door."""
import math
from typing import NamedTuple

AT_DOOR_M = 2.0


class Room(NamedTuple):
    level: int
    door: tuple
    west: float
    south: float
    east: float
    north: float

    def centre(self):
        return (self.west + self.east) / 2, (self.south + self.north) / 2, self.level

    def door_m(self, x, y):
        return math.hypot(x - self.door[0], y - self.door[1])

    def has(self, x, y, level):
        """Whether somebody there has come through the door, or is at it."""
        inside = self.west < x < self.east and self.south < y < self.north
        return level == self.level and (inside or self.door_m(x, y) <= AT_DOOR_M)


ROOMS = {
    "0.01": Room(0, (10.5, 17.0), 0.0, 17.0, 13.0, 24.0),
    "1.09": Room(1, (29.5, 14.0), 28.0, 7.0, 34.0, 14.0),
}
