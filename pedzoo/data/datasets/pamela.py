"""PAMELA: a hall of 6 x 11 m with 25 to 28 people, alone, or with a slow or a fast wheelchair."""

from typing import ClassVar

from pedzoo.data.datasets._files import FilesDataset


class Pamela(FilesDataset):
    """Nine runs; the walls and goals of the hall are not known."""

    FOLDS: ClassVar = {"pamela": ["pamela_S1_run3", "pamela_S2_run3", "pamela_S3_run3"]}
    ALWAYS_TRAINED: ClassVar = [
        "pamela_S1_run1", "pamela_S1_run2", "pamela_S2_run1", "pamela_S2_run2", "pamela_S3_run1",
        "pamela_S3_run2",
    ]  # fmt: skip
    VALIDATED: ClassVar = ["pamela_S1_run2"]
    DT: ClassVar = 0.08
    PHASES: ClassVar = (0, 1, 2, 3)
    REPLAYED: ClassVar = False
    SOURCE: ClassVar = "UCL PAMELA; https://github.com/akaimody123/PAMELA_dataset"
    TERMS: ClassVar = "no licence stated: research use"
    CITATION: ClassVar = "UCL PAMELA pedestrian and robot trajectories (Jia and others)"
