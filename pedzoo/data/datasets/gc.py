"""Grand Central: an indoor hall, clips of 60 s with about 100 people each in 20 x 20 m.

Zhang et al., "Physics-infused machine learning for crowd simulation", KDD 2022, train on the clips of 2104,
2164 and 2224 s and report that of 2344 s. It is tested here, too, and nothing trains on it.
"""

from typing import ClassVar

from pedzoo.data.datasets._files import FilesDataset


class Gc(FilesDataset):
    """The clips; places were marked every 0.8 s, so that steps are smooth."""

    FOLDS: ClassVar = {"gc": ["gc_2344"]}
    ALWAYS_TRAINED: ClassVar = [
        "gc_1000", "gc_1280", "gc_1880", "gc_2040", "gc_2104", "gc_2164", "gc_2224", "gc_2284", "gc_760"
    ]  # fmt: skip
    VALIDATED: ClassVar = ["gc_760"]
    DT: ClassVar = 0.08
    PHASES: ClassVar = (0, 2)
    REPLAYED: ClassVar = False
    SOURCE: ClassVar = (
        "Grand Central Station; clips in https://github.com/tsinghua-fib-lab/SPDiff, data_origin/GC_dataset"
    )
    TERMS: ClassVar = "no licence stated: research use"
    CITATION: ClassVar = (
        "S. Yi, H. Li, X. Wang, Understanding pedestrian behaviors from stationary crowd groups, CVPR 2015; "
        "G. Zhang et al., Physics-infused machine learning for crowd simulation, KDD 2022"
    )
