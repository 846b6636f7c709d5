"""An agent of your own that drives: it wanders where there is room, without a goal."""

from math import atan2, cos, hypot, pi, sin

import armadico
from armadico import Behaviour, Bid, Obstacles, Pose


class Wanderer(Behaviour):
    """Drives straight; near an obstacle it turns to the side with more room."""

    name = "wanderer"
    needs_goal = False

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        v, w = 0.3, 0.2 * sin(0.05 * pose.cycle.number)
        ahead = self.room(obstacles, 0.0)
        if ahead < 0.9:
            left, right = self.room(obstacles, pi / 4), self.room(obstacles, -pi / 4)
            v, w = max(0.0, 0.3 * (ahead - 0.5)), 0.8 if left > right else -0.8
        v, w = self.limited(v, w, obstacles)  # speeds that keep clear of obstacles
        return Bid(0.5, (v, w), reason=f"{ahead:.1f} m of room ahead")

    def room(self, obstacles: Obstacles, bearing: float) -> float:
        """The distance to the nearest obstacle in a direction, at most 3 m."""
        return min(
            (hypot(p.x, p.y) for p in obstacles.points if cos(atan2(p.y, p.x) - bearing) > 0.8),
            default=3.0,
        )


if __name__ == "__main__":
    world = armadico.Scenario(world="rooms-a", start=(1, 1, pi / 2))
    done = armadico.run(world, virtual=True, limit=60.0, joins=[Wanderer])
    print(done.measures.verdict, done.measures.shares)
    done.plot("wanderer.png")
