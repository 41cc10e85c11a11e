"""What each metric of robots is, in a line."""

from collections.abc import Mapping

LEGEND: Mapping[str, str] = {
    "success": "share of robots that reach all goals in time, and touch nothing that ends the episode",
    "collision_person": "share of robots that touch a person",
    "collision_robot": "share of robots that touch another robot",
    "collision_wall": "share of robots that touch a wall",
    "timeout": "share of robots whose time is up: max(20 s, 4 x the way's time at top speed)",
    "failed": "share of robots whose episode ends because an action was no number",
    "robot_on_person": "share of robots that touch a person by moving faster towards it than it does",
    "person_on_robot": "share of robots that a person touches so",
    "spl": "success, weighted by the planned way divided by the driven one (Anderson et al. 2018)",
    "stl": "success, weighted by the time of the planned way at top speed by the time taken (iGibson)",
    "time_s": "until the goal, mean of robots that succeed (CrowdNav)",
    "duration_s": "of all episodes, however they end (HuNav)",
    "path_m": "way that robots drive, however the episode ends (CrowdNav++, HuNav)",
    "path_ratio": "way that all robots that succeed drive, divided by the planner's",
    "final_goal_distance_m": "distance to the goal where the episode ends (HuNav)",
    "least_goal_distance_m": "least distance to the goal (HuNav)",
    "standing_s": "time of an episode in which the robot neither drives nor turns (HuNav)",
    "heading_change_rad": "turning left and right, added up over an episode (HuNav)",
    "speed_m_per_s": "mean speed of robots while they are on their way (HuNav)",
    "acceleration_m_per_s2": "mean amount of acceleration, over 0.4 s",
    "jerk_m_per_s3": "mean amount of jerk, over 0.4 s",
    "personal_space": "share of the time in which no person is within 0.5 m, between centres (iGibson)",
    "discomfort": "share of the time in which a person's body is within 0.2 m of the robot's (CrowdNav)",
    "intrusion_ratio": "share of an episode in which the robot is where a person will be within 1.25 s, mean "
    "over episodes (CrowdNav++)",
    "intrusion_distance_m": "distance between centres in these intrusions (CrowdNav++)",
    "nearest_person_m": "mean distance between the robot's body and the nearest person's (HuNav)",
    "least_person_m": "least distance between the robot's body and a person's centre in an episode (HuNav)",
    "farthest_person_m": "largest such distance (HuNav)",
    "space_intimate": "share of the time in which the nearest person is within 0.45 m of the robot (HuNav)",
    "space_personal": "share in which it is farther, within 1.2 m (HuNav)",
    "space_social": "share in which it is farther, within 3.6 m (HuNav)",
    "social_force_m_per_s2": "social force between robot and people, mean over time (HuNav sums it)",
    "people_speed_m_per_s": "mean speed of people beside the robot (HuNav)",
    "delay_s": "how much later a person arrives because of the robot, against the same scene without it: "
    "mean over people",
    "delay_total_s": "likewise the sum over all people of an episode",
    "detour_m": "how much farther a person walks for the same progress because of the robot",
    "contacts_more_per_min": "touches of others, robot included, that people have more with the robot, by "
    "minutes that people walk",
    "wall_contacts_more_per_min": "touches of walls, likewise",
    "encounters_per_min": "people with whom the robot would collide in less than 3 s, by its minutes",
    "person_yields": "share of these encounters in which the person changes its velocity more than the robot",
}
"""What each metric is, in the order of tables."""
