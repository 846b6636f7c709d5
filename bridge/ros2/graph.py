"""The publishers and subscriptions around a ROS 2 robot, and which do not match; sans-IO.

DDS and rmw_zenoh report endpoints each in their own way; both are judged here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec import Struct

from armadico.bridge.ros2.frames import Seen, Wanted

ODOMETRY = "nav_msgs/msg/Odometry"
"""The robot is the node that publishes this."""

SHOWN = 8
"""Most topics that are named where the robot is missing."""

_ALONE = "no other node is present: is it on, in this network, and in this domain?"

_TWISTS = {"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"}
"""Both are in use for commands; a profile selects one."""

_PLUMBING = ("/rosout", "/parameter_events", "/ros_discovery_info")


class Endpoint(Struct, frozen=True):
    """A publisher or a subscription of another node."""

    topic: str  # its whole name: /odom
    type: str  # as ROS 2 writes it
    node: str  # its node: /turtlebot3_node, or a description if it has no name
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
    """Judge the endpoints around a robot agent.

    The topics `wanted` are read and written here; names without a leading slash are in `namespace`.
    `where` is the network in words, "domain 0", and `others` all endpoints but one's own. Until
    discovery has `settled` nothing is reported as missing. `lonely` is a hint for the case that no
    other node is found.
    """
    others = tuple(others)
    robots: list[str] = []  # one per publisher: two robots of one make have the same name
    drivers: set[str] = set()
    notes: list[str] = []
    absent: list[str] = []  # the robot itself
    missed: list[str] = []
    unread = ""
    for want in wanted:
        name = resolve(namespace, want.topic)
        there = [other for other in others if other.topic == name]
        opposite = [other for other in there if other.writes is not want.writes]
        fitting = [other for other in opposite if other.type == want.type]
        if want.writes:
            drivers |= {other.node for other in there if other.writes}
            unread = "" if fitting else "; ".join(_types(want, name, opposite))
        elif want.type == ODOMETRY:
            robots += sorted(other.node for other in fitting)
        if not want.writes or fitting:
            notes += _types(want, name, opposite)
        for other in fitting:
            notes += _quality(want, name, other)
        if settled and not opposite:
            if want.type == ODOMETRY and not want.writes:
                instead = _instead(want.topic, others) or f"{_ALONE}{lonely}"
                absent = [f"no robot publishes {name} ({want.type}) in {where}; {instead}"]
            else:
                does = "reads" if want.writes else "publishes"
                missed.append(f"no node {does} {name} in {where}")
    # Without a robot the other missing topics are no news.
    notes += absent or missed
    several = len(robots) > 1
    if several:
        notes.append(f"more than one robot publishes odometry here: {', '.join(robots)}")
    robot = min(robots, default="")
    who = tuple(map(_cut, sorted(drivers)))[:100]
    return Seen(_cut(robot), who, tuple(map(_cut, notes))[:100], several, _cut(unread))


def _types(want: Wanted, name: str, opposite: Iterable[Endpoint]) -> list[str]:
    """Endpoints of another type, which exchange nothing with ours."""
    does = "reads" if want.writes else "publishes"
    ours = "published" if want.writes else "read"
    return [
        f"{other.node} {does} {name} as {other.type}; here it is {ours} as {want.type}"
        + (": see `stamped` in its profile" if {other.type, want.type} == _TWISTS else "")
        for other in opposite
        if other.type != want.type
    ]


def _quality(want: Wanted, name: str, other: Endpoint) -> list[str]:
    """Mismatches of QoS: nothing is sent where one end requests more than the other offers."""
    offered, requested = (want, other) if want.writes else (other, want)
    pairs = []
    if requested.reliable and not offered.reliable:
        pairs.append(("best effort", "reliable"))
    if requested.latched and not offered.latched:
        pairs.append(("volatile", "transient local"))
    ours = (f"{other.node} requests", "offered here") if want.writes else ("requested here", "")
    if want.writes:
        return [f"QoS of {name}: {ours[0]} {b}, {a} is {ours[1]}" for a, b in pairs]
    return [f"QoS of {name}: {other.node} offers {a}, {b} is {ours[0]}" for a, b in pairs]


def _instead(topic: str, others: Sequence[Endpoint]) -> str:
    """What is present instead of the robot's odometry; "": nothing."""
    writers = [o for o in others if o.writes and o.topic not in _PLUMBING]
    robots = sorted({o.topic for o in writers if o.type == ODOMETRY})
    if robots:
        same = any(name.endswith(f"/{topic}") for name in robots)
        question = "is that its namespace?" if same else "is it another make, with another profile?"
        return f"there is odometry on {', '.join(robots[:SHOWN])}: {question}"
    if not others:
        return ""
    nodes = sorted({other.node for other in others})
    topics = sorted({f"{o.topic} ({o.type})" for o in writers})
    more = f" and {len(topics) - SHOWN} more" if len(topics) > SHOWN else ""
    listed = f"{', '.join(topics[:SHOWN])}{more}" if topics else "no topics"
    return f"there is {', '.join(nodes[:SHOWN])} with {listed}"


def _cut(text: str) -> str:
    return "".join(filter(str.isprintable, text))[:500]
