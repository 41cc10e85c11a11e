"""How robots fare among people, and what they do to people.

Pure functions over the 0.1 s trace: E episodes of N people and R robots, T trace points. Point t is the end
of the t-th 0.1 s after the warm start. `pedzoo.metrics.robots.robot_metrics.robot_metrics` has all of them.

Numbers that count like others' are taken from where others define them:

* CrowdNav: Chen et al., "Crowd-robot interaction", ICRA 2019; vita-epfl/CrowdNav ``explorer.py``.
* CrowdNav++: Liu et al., "Intention aware robot crowd navigation", ICRA 2023;
  Shuijing725/CrowdNav_Prediction_AttnGraph ``evaluation.py``.
* HuNav: Perez-Higueras et al., "HuNavSim", RA-L 2023; robotics-upo/hunav_sim ``hunav_metrics.py``.
* iGibson: social navigation; ``STL`` and personal space of 0.5 m.

Of HuNav's list these are left out: group intrusions (people of pedzoo have no groups); obstacle forces, and
social work, which contains them (they sum over obstacle points that each simulator chooses by itself); mean
angular speed and mean acceleration with their sign (left and right, faster and slower cancel out: amounts
are here instead); its jerk, which is acceleration by time (`smoothness.jerk` is here). Its rule of which of
two collided with the other swaps the arguments of ``atan2``; `near.drives_into` says what is used instead.
Its social forces on the robot and on people are the same number: each pair's have the same amount.
"""
