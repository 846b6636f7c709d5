"""Who publishes and reads what around a ROS 2 robot, and what of it does not match; sans-IO.

DDS and rmw_zenoh tell of endpoints each in their own way; what follows from them is the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec import Struct

from armadico.bridge.ros2.frames import Seen, Wanted

ODOMETRY = "nav_msgs/msg/Odometry"
"""Who publishes it is the robot."""

TOLD = 8
"""So many of the topics that are there are named where the robot is not."""

_NOBODY = "nobody else is there: is it on, in this network, and in this domain?"

_TWISTS = {"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"}
"""Both are in use for commands; a profile says which."""

_PLUMBING = ("/rosout", "/parameter_events", "/ros_discovery_info")


class Endpoint(Struct, frozen=True):
    """A publisher or a subscription of somebody else."""

    topic: str  # its whole name: /odom
    type: str  # as ROS 2 writes it
    node: str  # whose: /turtlebot3_node, or what it is called without a name
    writes: bool
    reliable: bool = True
    latched: bool = False


def resolve(namespace: str, topic: str) -> str:
    """A topic's whole name: below the namespace, unless it begins with a slash."""
    if topic.startswith("/"):
        return topic
    return "/" + "/".join(filter(None, (namespace.strip("/"), topic)))


def judge(
    wanted: Sequence[Wanted],
    namespace: str,
    where: str,
    others: Iterable[Endpoint],
    settled: bool,
    lonely: str = "",
) -> Seen:
    """What there is to say of a robot's surroundings.

    Args:
        wanted: What is read and written here.
        namespace: Where names without a slash lie.
        where: The network, in words: "domain 0".
        others: All endpoints but one's own.
        settled: Whether they have had time to be found: until then nobody is missed.
        lonely: What else may be wrong where nobody else is there.
    """
    others = tuple(others)
    robots: list[str] = []  # one for each publisher: two of one make have the same name
    drivers: set[str] = set()
    notes: list[str] = []
    absent: list[str] = []  # the robot
    missed: list[str] = []
    for want in wanted:
        name = resolve(namespace, want.topic)
        there = [other for other in others if other.topic == name]
        opposite = [other for other in there if other.writes is not want.writes]
        fitting = [other for other in opposite if other.type == want.type]
        if want.writes:
            drivers |= {other.node for other in there if other.writes}
        elif want.type == ODOMETRY:
            robots += sorted(other.node for other in fitting)
        notes += _types(want, name, opposite)
        for other in fitting:
            notes += _quality(want, name, other)
        if settled and not opposite:
            if want.type == ODOMETRY and not want.writes:
                instead = _instead(want.topic, others) or f"{_NOBODY}{lonely}"
                absent = [f"no robot publishes {name} ({want.type}) in {where}; {instead}"]
            else:
                does = "reads" if want.writes else "publishes"
                missed.append(f"nobody {does} {name} in {where}")
    # Where there is no robot, what else there is not is no news.
    notes += absent or missed
    several = len(robots) > 1
    if several:
        notes.append(f"more than one robot publishes odometry here: {', '.join(robots)}")
    robot = min(robots, default="")
    who = tuple(map(_cut, sorted(drivers)))[:100]
    return Seen(_cut(robot), who, tuple(map(_cut, notes))[:100], several)


def _types(want: Wanted, name: str, opposite: Iterable[Endpoint]) -> list[str]:
    """Those of another type: they hear nothing of us, and we of them."""
    does = "reads" if want.writes else "publishes"
    ours = "published" if want.writes else "read"
    return [
        f"{other.node} {does} {name} as {other.type}; here it is {ours} as {want.type}"
        + (": see `stamped` in its profile" if {other.type, want.type} == _TWISTS else "")
        for other in opposite
        if other.type != want.type
    ]


def _quality(want: Wanted, name: str, other: Endpoint) -> list[str]:
    """Where one asks for more than the other offers nothing is sent at all."""
    offered, asked = (want, other) if want.writes else (other, want)
    words = []
    if asked.reliable and not offered.reliable:
        words.append(("best effort", "reliable"))
    if asked.latched and not offered.latched:
        words.append(("volatile", "transient local"))
    who = (f"{other.node} asks for", "offered here") if want.writes else ("asked for here", "")
    if want.writes:
        return [f"QoS of {name}: {who[0]} {b}, {a} is {who[1]}" for a, b in words]
    return [f"QoS of {name}: {other.node} offers {a}, {b} is {who[0]}" for a, b in words]


def _instead(topic: str, others: Sequence[Endpoint]) -> str:
    """What is there and not the robot's odometry; "": nobody is there."""
    writers = [o for o in others if o.writes and o.topic not in _PLUMBING]
    robots = sorted({o.topic for o in writers if o.type == ODOMETRY})
    if robots:
        same = any(name.endswith(f"/{topic}") for name in robots)
        ask = "is that its namespace?" if same else "is it another make, with another profile?"
        return f"there is odometry on {', '.join(robots[:TOLD])}: {ask}"
    if not others:
        return ""
    nodes = sorted({other.node for other in others})
    topics = sorted({f"{o.topic} ({o.type})" for o in writers})
    more = f" and {len(topics) - TOLD} more" if len(topics) > TOLD else ""
    said = f"{', '.join(topics[:TOLD])}{more}" if topics else "no topics"
    return f"there is {', '.join(nodes[:TOLD])} with {said}"


def _cut(text: str) -> str:
    return "".join(filter(str.isprintable, text))[:500]
