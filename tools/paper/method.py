"""What the paper's method is here, where it walks, and what of ours stands beside it."""

from typing import Any, NamedTuple

PAPER = "sgan_goal_map.eth_ucy:safety=false"
"""The paper's network, trained on recordings alone, without a safety layer: as the paper has it."""

LAYER, IN_LOOP = "sgan_goal_map.eth_ucy:safety=true", "sgan_goal_map.indoor:safety=false"
"""The paper's weights with our safety layer, and those that were trained on in the loop, without it."""

APPROACH = "approach_net_goal_map.indoor"
"""Another network than the paper's, taught in the loop, with the layer."""


class World(NamedTuple):
    """Where people walk, and what that changes; the defaults are the paper's."""

    changes: str
    physics: str = "bullet"
    planner: str = "astar"
    warm_start: str = "igibson"

    @property
    def settings(self) -> dict[str, Any]:
        """Fields of an `EvaluationCase`."""
        return {"planner": self.planner, "warm_start": self.warm_start}


PAPERS_WORLD = "pybullet, iGibson's ORCA, A*"
WORLDS = {
    PAPERS_WORLD: World("nothing"),
    "compiled physics": World("compiled loops in place of pybullet", physics="compiled"),
    "our planner": World("shortest ways in place of A*", planner="shortest"),
    "our warm start": World("ORCA of radius 0.2 in the first 2.8 s", warm_start="orca"),
}
"""The paper's world, and one change of it in each of the others."""

CHANGES = {
    PAPER: "nothing: the paper's method",
    IN_LOOP: "the same network, trained on while it walks, mostly at doors; without the layer",
    LAYER: "the safety layer takes steps off people and walls",
    APPROACH: "another network: approach pooling, a residual on the bent line, no AlexNet, no GAN; "
    "taught in the loop; with the layer",
}
"""What a policy changes in the paper's method, in the paper's world."""

NOTES = (
    f"the paper's method is `{PAPER}`: its network (Social GAN's pooling, the goal, AlexNet on the floor "
    "plan, GAN), trained on recordings alone, in pybullet, after iGibson's ORCA, on ways of A*. All else is "
    "ours, or a rule",
    "safety layer: the paper has none; of learned rows those without it say `safety=false`, and ORCA and "
    "social force never have it",
    "residual: the paper's network decodes steps; `approach_net` adds its output to the bent line to the "
    "goal, which untrained walks there, too",
    "GAN: the paper's network was trained against a discriminator; `approach_net` was not, and training in "
    "the loop does not use it",
)
"""What pages about walks say: which rows are the paper's, and a sentence each on layer, residual and GAN."""
