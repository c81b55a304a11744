"""Obstacles as MAVLink tells of them: distances around the vehicle, points, vessels, aircraft.

    OBSTACLE_DISTANCE       up to 72 sectors, each with the distance of what is nearest in it
    OBSTACLE_DISTANCE_3D    a point for each message, in the vehicle's frame or the local one
    AIS_VESSEL              latitude, longitude, course, speed, the sides of the hull
    ADSB_VEHICLE            latitude, longitude, course, speed, altitude

A sector at the distance d, of the width w, is where something is on an arc: the capsules around its
chords of at most `WIDEST`, with the sagitta as radius, cover it and reach at most two sagittas
nearer, .02 d at most. A latitude and a longitude are placed by where the autopilot says that the
vehicle, or its local origin, is; the radii of curvature of WGS 84 make them lengths.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.interop.mavlink.frames import Message, dialect
from holdfast.interop.planar_motion import PlanarMotion
from holdfast.planning.moving_obstacles import Obstacle

RANGES = ("OBSTACLE_DISTANCE", "OBSTACLE_DISTANCE_3D")
TRAFFIC = ("AIS_VESSEL", "ADSB_VEHICLE")
PLACES = ("GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT")
KINDS = frozenset((*RANGES, *TRAFFIC))

GLOBAL, LOCAL_NED, BODY_FRD = 0, 1, 12
"""Frames: the angles of sectors are from north in the first two, from the bow in the third."""
UNKNOWN = 0xFFFF
MOST = 500
"""Vessels and aircraft, and points without a number."""
WIDEST = math.radians(10)
"""A wider sector has several chords."""
EQUATOR, FLATTENING = 6_378_137.0, 1 / 298.257223563
"""WGS 84 [m]."""
DEGREE = 1e-7 * math.pi / 180
"""The unit of a latitude [rad]."""
TURN = 36000
"""A whole turn [hundredths of a degree]; more is no course."""


@checked
@dataclass(frozen=True)
class Lookout:
    """What a component takes for obstacles, beside what the messages say.

    ranges: whether a sensor of distances has to be heard within the patience of the component;
    without one nothing is promised. With False vessels and aircraft are all that is counted with,
    and where none is heard none is there. radius [m]: of a point, a vessel and an aircraft without
    a size; of those with one it is added. velocity_error [m/s], acceleration [m/s^2]: of vessels
    and aircraft, see `hf.Obstacle`; unknown_speed [m/s]: what one without a valid velocity may
    have. lasts [s]: how long a vessel counts after it was last heard; it grows meanwhile by what
    it may have done. height [m]: aircraft that fly higher or lower than the vehicle by more do not
    count.

    Raises `SimulationError` for a number below 0.
    """

    ranges: bool = True
    radius: float = 0.5
    velocity_error: float = 0.1
    acceleration: float = 0.0
    unknown_speed: float = 5.0
    lasts: float = 30.0
    height: float = 100.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0):
                raise SimulationError(f"{name} is {value}", expected="0 or more")


@dataclass(frozen=True)
class _Place:
    """Where something is: latitude and longitude [rad] and, of the same point, north, east [m]."""

    latitude: float
    longitude: float
    north: float
    east: float

    def ground(self, latitude: float, longitude: float) -> tuple[float, float]:
        """North and east [m] of another latitude and longitude."""
        squared = FLATTENING * (2 - FLATTENING)
        middle = (self.latitude + latitude) / 2
        w = math.sqrt(1 - squared * math.sin(middle) ** 2)
        along = EQUATOR * (1 - squared) / w**3
        across = EQUATOR / w * math.cos(middle)
        turned = math.remainder(longitude - self.longitude, 2 * math.pi)
        return (
            self.north + along * (latitude - self.latitude),
            self.east + across * turned,
        )


@dataclass(frozen=True)
class _Vessel:
    """Something that moves: its outline, of the time `at` [s]."""

    obstacle: Obstacle
    at: float
    heard: float

    def of(self, at: float) -> Obstacle:
        """The same, known at a time."""
        return self.obstacle.aged(at - self.at)


class Watch:
    """The obstacles that were heard of, in the axes of the system.

    taken: messages that say where obstacles are. refused: those in another frame, of impossible
    numbers, or without a place yet; why: what was wrong with the last of these.
    """

    def __init__(self, planar: PlanarMotion, lookout: Lookout, patience: float) -> None:
        self.planar, self.lookout, self.patience = planar, lookout, patience
        self.taken, self.refused, self.why = 0, 0, ""
        self._sectors: dict[tuple[int, int], tuple[float, list[Obstacle]]] = {}
        self._points: dict[tuple[int, int], tuple[float, Obstacle]] = {}
        self._traffic: dict[tuple[str, int], _Vessel] = {}
        self._pose: tuple[float, float, float] | None = None
        self._place: _Place | None = None
        self._altitude = math.nan
        self._ranged, self._nameless = -math.inf, 0

    def forget(self) -> None:
        """The vehicle has started again: nothing that was heard counts."""
        self.__init__(self.planar, self.lookout, self.patience)  # type: ignore[misc]

    def measured(self, states: dict[str, float]) -> None:
        """The vehicle is there."""
        x, y, heading = (states[name] for name in self.planar.pose)
        self._pose = (x, y, heading) if math.isfinite(x + y + heading) else None

    def placed(self, message: Message) -> None:
        """Where the vehicle, or its local origin, is on the Earth; a message of the autopilot."""
        if message.get_type() == "GPS_GLOBAL_ORIGIN":
            self._place = _Place(message.latitude * DEGREE, message.longitude * DEGREE, 0.0, 0.0)
            return
        self._altitude = message.alt * 1e-3
        if self._pose is not None and (message.lat or message.lon):
            ground = self.planar.to_ground(*self._pose[:2])
            self._place = _Place(message.lat * DEGREE, message.lon * DEGREE, *ground)

    def take(self, message: Message, now: float) -> None:
        """A message of `KINDS`, received at `now` [s]."""
        read = {
            "OBSTACLE_DISTANCE": self._distances,
            "OBSTACLE_DISTANCE_3D": self._point,
            "AIS_VESSEL": self._vessel,
            "ADSB_VEHICLE": self._aircraft,
        }[message.get_type()]
        if why := read(message, now):
            self.refused, self.why = self.refused + 1, f"{message.get_type()} {why}"
        else:
            self.taken += 1

    def around(self, now: float) -> tuple[list[Obstacle], float] | None:
        """The obstacles that count at `now` [s], and the time of the list; None without one."""
        at = self._ranged if self.lookout.ranges else now
        if math.isinf(at):
            return None
        recent = now - self.patience
        obstacles = [o for heard, row in self._sectors.values() if heard >= recent for o in row]
        self._points = {k: p for k, p in self._points.items() if p[0] >= recent}
        obstacles += [o for _, o in self._points.values()]
        lasting = now - self.lookout.lasts
        self._traffic = {k: v for k, v in self._traffic.items() if v.heard >= lasting}
        return obstacles + [v.of(at) for v in self._traffic.values()], at

    # -- distances -------------------------------------------------------------------------------

    def _distances(self, message: Message, now: float) -> str:
        if self._pose is None:
            return "before the vehicle's position is known"
        if message.frame not in (GLOBAL, LOCAL_NED, BODY_FRD):
            return f"in the frame {message.frame}, and not {GLOBAL}, {LOCAL_NED} or {BODY_FRD}"
        width = math.radians(message.increment_f or message.increment)
        count = len(message.distances)
        if not (math.isfinite(width) and 0 < abs(width) <= 2 * math.pi):
            return f"of sectors of {math.degrees(width):g} deg"
        if not math.isfinite(message.angle_offset):
            return f"with the offset {message.angle_offset}"
        sectors = [d for d in message.distances[:count] if d != UNKNOWN]
        if not sectors:
            return "of which every sector is unknown"
        x, y, heading = self._pose
        bow = self.planar.bearing - heading if message.frame == BODY_FRD else 0.0
        first = bow + math.radians(message.angle_offset)
        obstacles = []
        for k, centimetres in enumerate(message.distances):
            if centimetres == UNKNOWN or centimetres > message.max_distance:
                continue
            name = f"sector {k}"
            angle = first + k * width
            obstacles.append(self._sector(x, y, angle, abs(width), centimetres / 100, name))
        self._sectors[message.get_srcComponent(), message.sensor_type] = now, obstacles
        self._ranged = now
        return ""

    def _sector(
        self, x: float, y: float, angle: float, width: float, distance: float, name: str
    ) -> Obstacle:
        """What is on an arc around (x, y): angle, clockwise from north, in its middle."""
        chords = math.ceil(width / WIDEST - 1e-9)
        step = width / chords
        ends = []
        for k in range(chords + 1):
            bearing = angle - width / 2 + k * step
            dx, dy = self.planar.from_ground(
                distance * math.cos(bearing), distance * math.sin(bearing)
            )
            ends.append((x + dx, y + dy))
        sagitta = distance * (1 - math.cos(step / 2))
        bodies = tuple(((ends[k], ends[k + 1]), sagitta) for k in range(chords))
        return Obstacle(bodies, name=name)

    def _point(self, message: Message, now: float) -> str:
        if message.frame == LOCAL_NED:
            x, y = self.planar.from_ground(message.x, message.y)
        elif message.frame == BODY_FRD:
            if self._pose is None:
                return "before the vehicle's position is known"
            x, y, heading = self._pose
            cos, sin = math.cos(heading), math.sin(heading)
            x += message.x * cos + message.y * sin  # ahead, to the right
            y += message.x * sin - message.y * cos
        else:
            return f"in the frame {message.frame}, and not {LOCAL_NED} or {BODY_FRD}"
        if not math.isfinite(x + y):
            return f"at ({message.x}, {message.y})"
        number = message.obstacle_id
        key = (0, number)
        if number == UNKNOWN:
            key, self._nameless = (1, self._nameless), (self._nameless + 1) % MOST
        name = "point" if number == UNKNOWN else f"point {number}"
        self._points[key] = now, Obstacle.disc((x, y), self.lookout.radius, name=name)
        self._ranged = now
        return ""

    # -- vessels and aircraft --------------------------------------------------------------------

    def _vessel(self, message: Message, now: float) -> str:
        flags = message.flags
        name = message.name.strip("@ ") or message.callsign.strip("@ ") or f"MMSI {message.MMSI}"
        sides: tuple[float, ...] = ()
        if flags & dialect.AIS_FLAGS_VALID_DIMENSIONS:
            sides = (
                message.dimension_bow, message.dimension_stern,
                message.dimension_port, message.dimension_starboard,
            )  # fmt: skip
        heading = message.heading if 0 < message.heading < TURN else None  # 0: or not available
        moving = flags & dialect.AIS_FLAGS_VALID_VELOCITY and flags & dialect.AIS_FLAGS_VALID_COG
        course = message.COG if moving else None
        return self._moving(
            ("AIS", message.MMSI), name, message, course, message.velocity, sides, heading, now
        )

    def _aircraft(self, message: Message, now: float) -> str:
        flags = message.flags
        if not flags & dialect.ADSB_FLAGS_VALID_COORDS:
            return "without valid coordinates"
        key = "ADSB", message.ICAO_address
        if flags & dialect.ADSB_FLAGS_VALID_ALTITUDE:
            apart = abs(message.altitude * 1e-3 - self._altitude)
            if apart > self.lookout.height:  # not where the altitude of the vehicle is unknown
                self._traffic.pop(key, None)
                return ""
        moving = flags & dialect.ADSB_FLAGS_VALID_VELOCITY and flags & (
            dialect.ADSB_FLAGS_VALID_HEADING
        )
        course = message.heading if moving else None
        name = message.callsign.strip() or f"ICAO {message.ICAO_address:06X}"
        return self._moving(key, name, message, course, message.hor_velocity, (), None, now)

    def _moving(
        self,
        key: tuple[str, int],
        name: str,
        message: Message,
        course: int | None,
        speed: int,
        sides: Sequence[float],
        heading: int | None,
        now: float,
    ) -> str:
        """course, heading [hundredths of a degree from north]; speed [cm/s]; sides [m]."""
        if self._place is None:
            return "before the place of the vehicle on the Earth is known"
        latitude, longitude = message.lat * DEGREE, message.lon * DEGREE
        if abs(latitude) > math.pi / 2 or abs(longitude) > math.pi:
            return f"at the latitude {message.lat} and the longitude {message.lon}"
        if len(self._traffic) >= MOST and key not in self._traffic:
            return f"of more than {MOST} vessels and aircraft"
        look = self.lookout
        centre = self._place.ground(latitude, longitude)
        velocity, error = (0.0, 0.0), look.unknown_speed
        if course is not None and course < TURN:
            angle = math.radians(course / 100)
            north, east = speed / 100 * math.cos(angle), speed / 100 * math.sin(angle)
            velocity, error = self.planar.from_ground(north, east), look.velocity_error
        bow, stern, port, starboard = sides if len(sides) == 4 else (0.0,) * 4
        radius = look.radius
        corners = [(0.0, 0.0)]
        if heading is None:
            radius += math.hypot(max(bow, stern), max(port, starboard))
        else:
            corners = list(_rectangle(bow, stern, port, starboard, math.radians(heading / 100)))
        placed = tuple(self.planar.from_ground(centre[0] + n, centre[1] + e) for n, e in corners)
        flat = (bow + stern) * (port + starboard) == 0
        if len(placed) > 1 and flat:  # a line, or a point
            placed = (placed[0], placed[2]) if bow + stern + port + starboard > 0 else placed[:1]
        obstacle = Obstacle(
            ((placed, radius),), velocity=velocity, velocity_error=error,
            acceleration=look.acceleration, name=name,
        )  # fmt: skip
        self._traffic[key] = _Vessel(obstacle, now - message.tslc, now)
        return ""


def _rectangle(
    bow: float, stern: float, port: float, starboard: float, heading: float
) -> Iterator[tuple[float, float]]:
    """The corners of a hull, north and east of its antenna."""
    cos, sin = math.cos(heading), math.sin(heading)
    for ahead, right in ((bow, -port), (bow, starboard), (-stern, starboard), (-stern, -port)):
        yield ahead * cos - right * sin, ahead * sin + right * cos
