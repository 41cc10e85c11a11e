"""ETH/UCY from public repositories, in the layout that `pedzoo.data.datasets.eth_ucy` reads."""

import json
from pathlib import Path
from string import Template
from typing import Any

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_atomically
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datasets.eth_ucy import SCENES, TRUE_SECONDS, EthUcy
from pedzoo.data.published.files import PublishedFile, bring, files_of
from pedzoo.data.published.floor_plans import FRAMES, floor_plan, plan_of_recording
from pedzoo.maps.formats import write_ros

TERMS = f"{EthUcy.TERMS}{EthUcy.PLAN_TERMS}. For research; do not pass the files on inside a package."
CITATION = f"{EthUcy.CITATION}; for the split: A. Gupta et al., Social GAN, CVPR 2018"


def download(folder: Path) -> list[PublishedFile]:
    """Bring ETH/UCY into a folder and return the files that came from elsewhere; a second call mends it.

    ``splits.json`` is written last: by it the folder is known to be whole.

    Raises:
        UserError: A file cannot be had, or the folder cannot be written. What is there is kept.
    """
    files = files_of("eth_ucy")
    bring(files, folder, "eth_ucy")
    try:
        for scene in FRAMES:
            write_ros(floor_plan(scene, folder), folder / "maps" / f"{scene}.yaml")
        sums = "".join(f"{file.sha256}  {file.path}\n" for file in files)
        write_atomically(folder / "SHA256SUMS", sums.encode())
        write_atomically(folder / "README.md", _readme(files).encode())
        write_atomically(folder / "splits.json", (json.dumps(splits(), indent=1) + "\n").encode())
    except OSError as error:
        raise UserError(f"cannot write into {str(folder)!r}: {error.strerror}") from error
    return files


def splits() -> dict[str, Any]:
    """Return the content of ``splits.json``: leave one scene out, the rest cut in time as by Social GAN.

    The scene's other recordings, zara03 and uni_examples, stay in the training set.
    """
    plans = plan_of_recording()
    folds = {}
    for scene in SCENES:
        tested = EthUcy.FOLDS[scene]
        others = sorted(set(plans) - set(tested))
        folds[scene] = {
            "train": [f"train/{name}_train.txt" for name in others],
            "val": [f"val/{name}_val.txt" for name in others],
            "test": [f"raw/{name}.txt" for name in tested],
        }
    return {
        "seconds_per_step": STEP_SECONDS,
        "true_seconds_per_step": {name: round(TRUE_SECONDS.get(name, STEP_SECONDS), 4) for name in plans},
        "map_of_recording": plans,
        "folds": folds,
    }


def _readme(files: list[PublishedFile]) -> str:
    used = dict.fromkeys(file.places[0][:2] for file in files)
    sources = "\n".join(f"- https://github.com/{repository} at {commit}" for repository, commit in used)
    text = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    return Template(text).substitute(terms=TERMS, citation=CITATION, sources=sources)
