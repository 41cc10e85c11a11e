"""Mistakes are refused, and help is printed, before anything heavy is imported."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

from pedzoo.cli.main import PAGES, main
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROOT

pytestmark = pytest.mark.usefixtures("elsewhere")

HEAVY = {
    "torch",
    "lightning",
    "torchrl",
    "tensordict",
    "numpy",
    "scipy",
    "rich",
    "jsonargparse",
    "matplotlib",
}

OWN = """
from pedzoo.policies.policy import Policy as Base

class Gru(Base):
    pass

def waits(rollout):
    return rollout.mask.sum(1), rollout.mask.sum(1)
"""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("rollout orcaa", "unknown policy 'orcaa': did you mean 'orca'?"),
        ("rollout orca:radus=3", "unknown setting of policy orca 'radus': did you mean 'radius'?"),
        ("rollout orca+sgan_goal_map.indor", "did you mean 'sgan_goal_map.indoor'?"),
        ("rollout sgan_goal.zara1:saftey=no", "did you mean 'safety'?"),
        ("rollout orca --scenario dor", "unknown scenario 'dor': did you mean 'door'?"),
        (
            "rollout orca --scenario door:widht=1",
            "unknown setting of scenario door 'widht': did you mean 'width'?",
        ),
        ("rollout orca --episode 3", "unknown option --episode: did you mean --episodes?"),
        ("rollout orca --physics bulet", "unknown physics 'bulet': did you mean 'bullet'?"),
        ("evaluate orca --suite door,gols", "unknown suite 'gols': did you mean 'goals'?"),
        ("evaluate none.ckpt", "no checkpoint at 'none.ckpt'"),
        ("forecast sgan_goal.zara7", "unknown model 'sgan_goal.zara7': did you mean"),
        ("fit --config sgan_goall", "unknown config 'sgan_goall': did you mean 'sgan_goal'?"),
        ("fit --config sgan_goal --model.lrr 1", "did you mean --model.lr?"),
        ("fit --config closed_loop/sgan_goal_map --model.steeps 1", "did you mean --model.steps?"),
        ("fit --config sgan_goal --data.fold zara9", "unknown fold 'zara9': did you mean 'zara"),
        ("fit --config sgan_goal --data.files none.csv", "no file 'none.csv'"),
        ("fit --config sgan_goal --data.files CSV --data.dt 0.4", "has no column 'agent'"),
        ("score CSV --against zara1", "has no column 'agent'"),
        ("forecast robot_ppo.mix", "'robot_ppo.mix' moves robots"),
        ("export robot_ppo.mix --onnx r.onnx", "pedzoo evaluate robot_ppo.mix --suite robots"),
        ("rollout orca+robot_ppo.mix", "'robot_ppo.mix' moves robots"),
        ("fit --weights robot_ppo.mix", "'robot_ppo.mix' moves robots"),
        ("fit --resume nowhere", "cannot resume 'nowhere': it has no config.yaml"),
        ("score none.csv --against zara1", "no file 'none.csv'"),
        ("score orca --against none.csv", "--data.dt is None: give the seconds between two consecutive"),
        ("score orca --against none.csv", "frame numbers of the file of --against (0.04"),
        ("score orca --against zara1 --dt -1", "--dt is -1.0: give the seconds between"),
        ("score orca --against zara1 --rollouts 0", "--rollouts 0: expected at least 1"),
        ("rollout orca --metrics sucess", "unknown metric 'sucess': did you mean 'success'?"),
        ("rollout orca --scenario goals:map=apartmnt.7", "did you mean 'apartment.7'?"),
        ("evaluate orca --maps nowhere.yaml", "no map file 'nowhere.yaml'"),
        ("evaluate orca --suite robots --robot jackall", "unknown robot 'jackall': did you mean 'jackal'?"),
        ("view dor orca", "unknown scenario 'dor': did you mean 'door'?"),
        ("view door orcca", "unknown policy 'orcca': did you mean 'orca'?"),
        ("score orca --against zarra1", "unknown fold 'zarra1': did you mean 'zara1'?"),
        ("score ocra --against zara1", "unknown policy 'ocra': did you mean 'orca'?"),
        ("evaluate orca --metrics none.py:f", "no file 'none.py'"),
        ("rollout orca --episodes x", "--episodes x: expected a whole number"),
        ("fit --config sgan --data.goal widnow_end", "did you mean 'window_end'?"),
        ("export none.ckpt --onnx x.onnx", "no checkpoint at 'none.ckpt'"),
        ("rollout", "no policies: name them before the options, as in orca go_to_goal"),
        ("evaluate --quick", "no policies: name them before the options"),
        ("fit", "no model: choose one with --config NAME ("),
        ("fit --trainer.max_epochs 3", "no model: choose one with --config NAME ("),
        ("fit --config EMPTY", "empty.yaml': expected a mapping such as 'model: ...', not None"),
        ("rollout orca --plot a.txt", "--plot a.txt: expected a file that ends in .png or .pdf or .svg"),
        ("rollout orca --video door.foo", "--video door.foo: expected a file that ends in .webm or .mp4"),
        ("rollout orca --html door.txt", "--html door.txt: expected a file that ends in .html or .htm"),
        ("rollout orca --json door.csv", "--json door.csv: expected a file that ends in .json"),
        ("report a.json -o r.txt", "--out r.txt: expected a file that ends in .html or .htm"),
        ("rollout orca --episodes 0", "--episodes 0: expected at least 1"),
        ("evaluate orca --people orka", "unknown policy 'orka': did you mean 'orca'?"),
        ("rollout CODE", "code.py:CLASS, such as CODE:Gru\n"),
        ("rollout CODE:Gruu", "unknown class in CODE 'Gruu': did you mean 'Gru'? known: Gru\n"),
        ("rollout orca --scenario CODE", "code.py:CLASS, such as CODE:Gru\n"),
        ("rollout orca --metrics CODE", "code.py:FUNCTION, such as CODE:waits\n"),
        ("evaluate orca --metrics spl,CODE:wait", "unknown function in CODE 'wait': did you mean 'waits'?"),
    ],
)
def test_mistakes_are_refused_without_heavy_imports(line, message, tmp_path):
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("frame,person,x,y\n0,1,2,3\n")
    own, empty = tmp_path / "code.py", tmp_path / "empty.yaml"
    own.write_text(OWN)
    empty.touch()
    for word, file in (("CSV", wrong), ("CODE", own), ("EMPTY", empty)):
        line, message = line.replace(word, str(file)), message.replace(word, str(file))
    code = (
        "import sys; from pedzoo.cli.main import main; code = main(sys.argv[1:]);"
        f"heavy = {HEAVY} & set(sys.modules); assert not heavy, heavy; sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code, *line.split()], capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr and done.stderr.count("\n") == 1
    assert "Base" not in done.stderr


@pytest.mark.parametrize(
    "line",
    [
        "rollout orca:radius=0.3 file.py:Mine --scenario door:width=0.9,people=4 --video-view top",
        "rollout go_to_goal --scenario file.py:Mine:anything=1 --metrics spl,file.py:f",
        "evaluate sgan_goal_map.indoor:safety=false,noise=step orca:share=0.5+go_to_goal --suite cards",
        "evaluate orca --resume parts.journal",
        "evaluate robot_ppo.circle stop --suite robots --people orca,replay:fold=zara1",
        "forecast hf://OWNER/REPO bent_line --data.people present",
        "fit --config sgan_goal --data.files file.py --model.generator.noise_dim 4 --trainer.max_epochs=2",
        "fit --config robot/ppo --model.scenarios circle",
        "fit --model file.py --model.anything 3 --data.batch_size 4 --data.loading.max-pairs 9",
        "fit --model.lr 3",
        "score sgan_goal_map.indoor --against zara1",
        "rollout orca --scenario goals:map=flat --episodes=3",
        "evaluate orca --suite goals --maps office.3 file.py --metrics [spl,file.py:f]",
        "rollout orca --scenario custom:map=null",
        "rollout orca --scenario file.py:Mine:map=of_my_own",
        "score WALKS --against WALKS --data.dt 0.4",
        "view goals:map=[apartment.1,office.2] orca+go_to_goal",
        "rollout --episodes 3 orca",
        "rollout here.py:Imported here.py:Assigned --metrics here.py:Imported --json - --html a.HTM",
        "rollout made.py:Anything --metrics made.py:anything --json /dev/null",
        "rollout broken.py:Anything",
        "fit --config sgan_goal --data.fold here.py:Imported:fold",
        "evaluate orca --people replay,replay:fold=zara1,here.py:Imported --robot here.py:Other:x=1",
        "fit --print_config",
        "validate --ckpt_path here.py",
    ],
)
def test_what_may_be_right_passes(line, tmp_path, monkeypatch):
    from pedzoo.cli.checks import check

    monkeypatch.chdir(tmp_path)
    (tmp_path / "file.py").touch()
    here = "from elsewhere import Imported\nif True:\n    Assigned = Imported\nclass Other: ...\ndef f(): ..."
    (tmp_path / "here.py").write_text(here)
    (tmp_path / "made.py").write_text("from elsewhere import *\nclass Other: ...\ndef f(): ...")
    (tmp_path / "broken.py").write_text("class Other\n")
    (tmp_path / "walks.TSV").write_text("frame\tagent\tx\ty\n0\t1\t2\t3\n")
    words = line.replace("WALKS", "walks.TSV").split()
    check(words[0], words[1:])


@pytest.mark.parametrize("line", ["fit --config NAME", "fit --resume NAME", "report NAME"])
def test_names_that_are_too_long_are_refused_in_one_line(line, capsys):
    from pedzoo.cli.main import main

    assert main(line.replace("NAME", "a" * 300).split()) == 2
    error = capsys.readouterr().err
    assert "no file has so long a name" in error and error.count("\n") == 1


def test_odd_values_of_a_config_are_refused_as_by_its_reader(tmp_path):
    from pedzoo.cli.checks import check

    config = tmp_path / "odd.yaml"
    config.write_text("monitor: 2026-11-99")
    with pytest.raises(UserError, match=r"config '.*odd\.yaml' is no YAML: cannot be read: "):
        check("fit", ["--config", str(config)])
    config.write_text("model: 3")  # the command says what is wrong with it
    check("fit", ["--config", str(config)])


def test_pages_and_known_options_are_those_of_the_parsers():
    code = (  # a process of its own: options of subclasses that tests define are not shipped
        "import json; from tools.pages import command_pages as made;"
        "print(json.dumps([made.known(), made.pages()]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    known, pages = json.loads(done.stdout.splitlines()[-1])
    cure = "run python tools/pages/command_pages.py"
    assert json.loads((PAGES / "known.json").read_text()) == known, cure
    for name, text in pages.items():  # their form differs between versions of Python
        options = re.compile(r"--[\w.]+").findall
        assert set(options((PAGES / f"{name}.txt").read_text())) == set(options(text)), cure


def test_head_ends_a_command_without_a_traceback():
    line = f"{sys.executable} -m pedzoo models | head -1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
    assert done.stdout.count("\n") == 1 and "Traceback" not in done.stderr


def test_shells_complete_commands_options_and_names(capsys):
    def following(*words: str) -> list[str]:
        assert main(["completion", "words", *words]) == 0
        return capsys.readouterr().out.split()

    assert {"fit", "rollout"} <= set(following())
    assert {"--episodes", "orca", "sgan_goal_map.indoor"} <= set(following("rollout"))
    assert "door" in following("rollout", "orca", "--scenario")
    assert main(["completion", "bash"]) == 0
    assert "complete " in capsys.readouterr().out
