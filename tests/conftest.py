"""What all tests share."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from pedzoo.cli.main import main

torch.set_num_threads(1)
# the same for processes that tests start: a resumed training is equal to the bit only with one thread
os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# the same on every machine; CONTRIBUTING.md says which tests PEDZOO_TEST_GPU=1 shows GPUs to
if not os.environ.get("PEDZOO_TEST_GPU"):
    os.environ["CUDA_VISIBLE_DEVICES"] = ""
# a shell's background jobs ignore it, and so would the processes that tests interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def empty_cache(tmp_path_factory) -> Iterator[None]:
    """Keep what the user has downloaded out of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PEDZOO_HOME", str(tmp_path_factory.mktemp("pedzoo_home")))
        yield


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Make what a test draws independent of the tests before it."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with recordings, maps and weights: beside the checkout, or the variable ``PEDZOO_SHARED``."""
    given = os.environ.get("PEDZOO_SHARED")
    path = Path(given) if given else Path(__file__).parents[2] / "shared"
    if not path.is_dir():
        pytest.skip(f"needs the folder of recordings, maps and weights (PEDZOO_SHARED): {path} is absent")
    return path


@pytest.fixture
def alexnet(shared: Path, monkeypatch) -> Path:
    """AlexNet's published weights, where models find them."""
    weights = shared / "weights" / "alexnet_imagenet_features_fp16.safetensors"
    monkeypatch.setenv("PEDZOO_ALEXNET", str(weights))
    return weights


@pytest.fixture
def refused(capsys) -> Callable[..., str]:
    """Give a command line that is a mistake; returns the one line that is said about it."""

    def line_of(*words: str) -> str:
        capsys.readouterr()
        assert main(list(words)) == 2
        said = capsys.readouterr().err
        assert said.startswith("pedzoo: ") and said.count("\n") == 1, said
        return said

    return line_of


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """The working directory: an empty folder, so that each test writes runs and files of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
