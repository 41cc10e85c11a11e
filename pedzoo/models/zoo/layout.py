"""Where the files of a model lie: in a folder of its own, or beside other models as older exports wrote them.

The weights of ``FOLDER/NAME/card.yaml`` are ``FOLDER/NAME/weights.safetensors``. Those of
``FOLDER/NAME.yaml`` are in the file that the card names, as a rule ``FOLDER/NAME.safetensors``.
"""

from pathlib import Path

from pedzoo.core.paths import CARD, WEIGHTS
from pedzoo.models.zoo.card import ModelCard, is_name


def card_files(folder: Path) -> dict[str, Path]:
    """Return the cards of the models in a folder by name; a folder of the model's own wins."""
    files = [*folder.glob("*.yaml"), *folder.glob(f"*/{CARD}")]
    result = {name: path for path in files if is_name(name := name_of_files(path))}
    return {name: result[name] for name in sorted(result)}


def card_beside(weights: Path) -> Path:
    """Return where the card of weights lies."""
    return weights.with_name(CARD) if weights.name == WEIGHTS else weights.with_suffix(".yaml")


def weights_beside(path: Path, card: ModelCard) -> Path:
    """Return where the weights of a card lie."""
    return path.with_name(WEIGHTS if path.name == CARD else card.file)


def name_of_files(path: Path) -> str:
    """Return the name that the place of a card or of weights gives their model."""
    return path.parent.name if path.name in (CARD, WEIGHTS) else path.stem
