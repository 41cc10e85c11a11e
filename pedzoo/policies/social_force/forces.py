"""The forces of the social force model, as small pure functions; an acceleration in m/s^2 is called a force.

Equations are those of Helbing and Molnar, Phys. Rev. E 51, 4282 (1995). Coordinates come first, (2, K, N) for
K others of N people: on a CPU several times faster than pairs of coordinates. Everything is differentiable.
"""

import math

from torch import Tensor

from pedzoo.policies.orca.vectors import cross, dot, right

CLOSEST = 0.01
"""Metres: people are never closer than this to the centre of a potential, where its gradient is infinite."""

EXACT, OFF_LINE = 1e-5, 0.02
"""Shares of the distance: others so little off the line ahead are on it, and count as so much off it."""


def length(vector: Tensor, least: float) -> Tensor:
    """Return the lengths (...) of vectors (2, ...), and ``least`` for shorter ones, with gradient zero."""
    return dot(vector, vector).clamp_min(least * least).sqrt()


def direction(vector: Tensor) -> Tensor:
    """Return the directions (2, ...) of vectors; that of a zero vector is zero."""
    return vector / length(vector, 1e-6)


def closer(offset: Tensor, by: Tensor) -> Tensor:
    """Return offsets (2, ...) that are shorter ``by`` (...) metres, but not shorter than a hundredth."""
    share = (by / length(offset, CLOSEST)).clamp_max(0.99)
    return offset * (1 - share)


def off_line(offset: Tensor, heading: Tensor) -> Tensor:
    """Return offsets from others (2, K, N); those exactly ahead count as a little to the left.

    Else two who meet head-on make way to no side. ``heading`` (2, N) are the desired directions.
    """
    ahead = -dot(offset, heading.unsqueeze(1))
    tie = (cross(heading.unsqueeze(1).expand_as(offset), offset).abs() < EXACT * ahead).to(offset.dtype)
    return offset + tie * OFF_LINE * ahead * right(heading).unsqueeze(1)


def driving_force(velocity: Tensor, desired_velocity: Tensor, tau: float) -> Tensor:
    """Return the force from velocity to desired velocity (2, N), m/s, in ``tau`` seconds (eq. 2)."""
    return (desired_velocity - velocity) / tau


def repulsion(offset: Tensor, step: Tensor, strength: float, sigma: float) -> tuple[Tensor, Tensor]:
    """Return how strongly others repel (K, N), and in which direction (2, K, N) (eqs. 3 and 4).

    Lines of equal potential V0 exp(-b / sigma) around a person are ellipses with the foci p, where they are,
    and q, where their next step ends. With the distances r and s to p and q, unit vectors m and n away from
    them, and the ellipse's semi-minor axis b, 2 b = sqrt((r + s)^2 - |pq|^2), one finds b = sqrt(r s) |m +
    n| / 2: no small difference of large numbers. The gradient of b is (r + s) / (2 sqrt(r s)) long, never
    below 1, and bisects the angle between m and n.

    On the line between the foci, exactly in front of an approaching person, the direction is 0. At the foci
    the gradient is infinite; distances to them count as `CLOSEST` at least.

    Args:
        offset: From each other person to oneself (2, K, N), metres.
        step: From each other person to where their step ends (2, K, N), metres: Delta t times the velocity.
        strength: V0, m^2/s^2.
        sigma: Range, metres.
    """
    beyond = offset - step
    near, far = length(offset, CLOSEST), length(beyond, CLOSEST)
    both = offset / near + beyond / far
    size = length(both, 1e-6)
    mean = (near * far).sqrt()
    fall = (mean * size * (-0.5 / sigma)).exp()
    return fall * (near + far) / mean * (0.5 * strength / sigma), both / size


def view_weight(force: Tensor, heading: Tensor, angle: float, out_of_view: float) -> Tensor:
    """Return the weight (K, N) of forces (2, K, N) that come from in front or from behind (eq. 8).

    In view is what comes from within ``angle`` degrees of the heading (2, N), and all for a heading of 0.
    """
    seen = -dot(force, heading.unsqueeze(1)) >= math.cos(math.radians(angle))
    return out_of_view + (1 - out_of_view) * seen.to(force.dtype)


def smooth_weight(offset: Tensor, heading: Tensor, behind: float) -> Tensor:
    """Return weights (K, N) that fall from 1 in front to ``behind`` behind (Helbing et al. 2005)."""
    cosine = -dot(direction(offset), heading.unsqueeze(1))
    return behind + (1 - behind) * 0.5 * (1 + cosine)


def wall_force(offset: Tensor, weight: Tensor, strength: float, reach: float) -> Tensor:
    """Return the sum of the walls' forces on each person (2, N) (eq. 5), of points at offsets (2, M, N).

    Each counts with ``weight`` (M, N); ``strength`` is U0, m^2/s^2, and ``reach`` R, metres.
    """
    if not len(weight):
        return offset.new_zeros(2, weight.shape[1])
    distance = length(offset, 1e-6)
    force = offset * (weight * (distance * (-1 / reach)).exp() * (strength / reach) / distance)
    # one after the other: a sum's rounding would depend on how many points act on others
    return force.cumsum(1)[:, -1]
