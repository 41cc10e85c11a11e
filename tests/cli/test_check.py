"""Mistakes are one line; misspelt names and options are refused before anything heavy is imported."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pedzoo.cli.check import check_names
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROOT

pytestmark = pytest.mark.usefixtures("elsewhere")

HEAVY = {"torch", "lightning", "torchrl", "tensordict", "numpy", "scipy", "rich", "matplotlib"}

OWN = """
from pedzoo.policies.policy import Policy as Base

class Gru(Base):
    pass

def waits(rollout):
    return rollout.mask.sum(1), rollout.mask.sum(1)
"""

NAMES = [
    ("rollout go_to_goal orcaa", "unknown policy 'orcaa': did you mean 'orca'?"),
    ("rollout orca+approach_net_goal_map.indor", "did you mean 'approach_net_goal_map.indoor'?"),
    ("rollout orca --scenario dor", "unknown scenario 'dor': did you mean 'door'?"),
    ("rollout orca --episode 3", "unknown option --episode: did you mean --episodes?"),
    ("plans office --cuont 3", "unknown option --cuont: did you mean --count?"),
    ("evaluate orcs --suite encounters", "unknown policy 'orcs': did you mean 'orca'?"),
    ("evaluate none.ckpt", "no checkpoint at 'none.ckpt'"),
    ("forecast sgan_goal.zara7", "unknown model 'sgan_goal.zara7': did you mean"),
    ("fit --config sgan_goall", "unknown config 'sgan_goall': did you mean 'sgan_goal'?"),
    ("fit --config sgan_goal --model.lrr 1", "did you mean --model.lr?"),
    ("fit --config closed_loop/approach_net_goal_map --model.steeps 1", "did you mean --model.steps?"),
    ("forecast robot_ppo.mix", "'robot_ppo.mix' moves robots"),
    ("export robot_ppo.mix --onnx r.onnx", "pedzoo evaluate robot_ppo.mix --suite robots"),
    ("rollout orca+robot_ppo.mix", "'robot_ppo.mix' moves robots"),
    ("fit --weights robot_ppo.mix", "'robot_ppo.mix' moves robots"),
    ("view dor orca", "unknown scenario 'dor': did you mean 'door'?"),
    ("view door orcca", "unknown policy 'orcca': did you mean 'orca'?"),
    ("score ocra --against zara1", "unknown policy 'ocra': did you mean 'orca'?"),
    ("export none.ckpt --onnx x.onnx", "no checkpoint at 'none.ckpt'"),
    ("forcast", "did you mean 'forecast'?"),
    ("rollout", "no policies: name them before the options, as in orca go_to_goal"),
    ("evaluate --quick", "no policies: name them before the options"),
    ("fit", "no model: choose one with --config NAME ("),
    ("fit --trainer.max_epochs 3", "no model: choose one with --config NAME ("),
    ("fit --config empty.yaml", "empty.yaml': expected a mapping such as 'model: ...', not None"),
    ("report a.json -o r.txt", "--out r.txt: expected a file that ends in .html or .htm"),
    ("evaluate orca --people orka", "unknown policy 'orka': did you mean 'orca'?"),
    ("forecast nothing", "unknown model 'nothing'"),
]
"""Mistakes in names and options, and what is said about them."""

VALUES = [
    ("rollout sgan_goal.zara1:saftey=no", "did you mean 'safety'?"),
    ("evaluate orca --suite door,gols", "unknown suite 'gols': did you mean 'goals'?"),
    ("fit --config sgan_goal --data.fold zara9", "unknown fold 'zara9': did you mean 'zara"),
    ("fit --config sgan_goal --data.files none.csv --data.dt 0.4", "none.csv"),
    ("fit --config sgan_goal --data.files wrong.csv --data.dt 0.4", "has no column 'agent'"),
    ("score wrong.csv --against wrong.csv --data.dt 0.4", "has no column 'agent'"),
    ("fit --resume nowhere", "cannot resume 'nowhere': it has no config.yaml"),
    ("score none.csv --against none.csv --data.dt 0.4", "none.csv"),
    ("score orca --against none.csv", "--data.dt is None: give the seconds between two consecutive"),
    ("score orca --against none.csv", "frame numbers of the file of --against (0.04"),
    ("score orca --against zara1 --dt -1", "--dt is -1.0: give the seconds between"),
    ("evaluate orca --suite robots --robot jackall", "unknown robot 'jackall': did you mean 'jackal'?"),
    ("evaluate orca --metrics none.py:f", "no file 'none.py'"),
    ("rollout orca --episodes x", "--episodes: expected int, not 'x'"),
    ("fit --config sgan_nopool --data.goal widnow_end", "did you mean 'window_end'?"),
    ("rollout orca --plot a.txt", "--plot a.txt: expected a file that ends in .png or .pdf or .svg"),
    ("rollout orca --video door.foo", "--video door.foo: expected a file that ends in .webm or .mp4"),
    ("rollout orca --episodes 0", "episodes 0: expected at least 1"),
    ("rollout code.py", "code.py:CLASS, such as code.py:Gru\n"),
    ("rollout code.py:Gruu", "unknown class in code.py 'Gruu': did you mean 'Gru'? known: Gru\n"),
    ("rollout orca --scenario code.py", "code.py:CLASS, such as code.py:Gru\n"),
    ("rollout orca --metrics code.py", "code.py:FUNCTION, such as code.py:waits\n"),
    ("evaluate orca --metrics spl,code.py:wait", "unknown function in code.py 'wait': did you mean 'waits'?"),
    ("rollout orca --metrics success,sucess", "unknown metric 'sucess': did you mean 'success'?"),
    ("rollout orca --physics compild", "did you mean 'compiled'?"),
    ("rollout orca --warm_start orcas", "did you mean 'orca'?"),
    ("rollout orca --show 3 --episodes 3", "--show 3: expected 0 to 2"),
    ("rollout orca --json .", "--json .: is a folder"),
    ("rollout orca --plot wrong.csv/a.png", "wrong.csv' is a file, expected a folder"),
    ("rollout sgan_goal.zara1 --decision-dt 0.1", "every 0.4 s, not every 0.1 s: it was trained"),
    ("rollout orca --decision-dt 0.4", "orca:dt="),
    ("rollout orca:radios=1", "did you mean 'radius'?"),
    ("rollout go_to_goal --scenario door:widht=1", "did you mean 'width'?"),
    ("evaluate orca --suite goals --maps ofice.3", "did you mean 'office.3'?"),
    ("evaluate orca --suite replay --data.root nowhere", "data root 'nowhere' is not a folder"),
    ("evaluate orca --suite encounters --episodes 0", "episodes 0: expected at least 1"),
    ("evaluate orca --suite encounters --seeds 1,two", "--seeds 1,two: expected whole numbers"),
    ("evaluate orca --suite ,", "no suites"),
    ("evaluate orca --suite door --maps flat", "in door; goals, loop_buildings, table2 would have"),
    (
        "evaluate orca --suite replay --episodes 9",
        "in replay; door, encounters, figure4, goals, indoor",
    ),
    ("evaluate --maps flat orca --suite goals", "no policies: name them before the options"),
    ("evaluate orca --sute encounters", "--suite"),
    ("evaluate orca --suite encounters --plot a.png", "which is not asked for"),
    ("fit --config based.yaml", "unknown config 'sgan_gaol': did you mean 'sgan_goal'?"),
    ("fit --config sgan_nopool --data.fold zara1", "PEDZOO_DATA"),
    ("fit --config sgan_goal --data.fold embedded --data.goal none", "none"),
    ("fit --model.lr 1", "needs generator, too: start from --config NAME ("),
    ("test --config sgan_goal --data.fold embedded", "--ckpt_path"),
    ("demo --epochs 0", "--epochs 0: expected at least 1"),
    ("demo --out wrong.csv", "is a file, expected a folder"),
    ("plans office --count 1 --sheet full.png", "--sheet full.png: is a folder"),
    ("plans office --count 1 --json wrong.csv/a.json", "wrong.csv' is a file, expected a folder"),
    ("plans office --count 0", "--count 0: expected at least 1"),
    ("plans office --sheet sheet.jpg", "ends in .png or .pdf or .svg"),
    ("plans office --size 3,4", "expected width and height from 12 to 60 m"),
    ("forecast constant_velocity --json full.png", "--json full.png: is a folder"),
    ("export sgan_goal.zara1 --zoo", "expected RUN/checkpoints/best.ckpt, not 'sgan_goal.zara1'"),
    ("export best.ckpt --hub hub", "no checkpoint at 'best.ckpt'"),
    ("export sgan_goal.zara9 --hub hub", "unknown model 'sgan_goal.zara9': did you mean"),
    ("export sgan_goal.zara1", "one of the arguments --zoo --hub --onnx is required"),
    ("export sgan_goal.zara1 --zoo --hub hub", "not allowed with argument"),
    ("export sgan_goal.zara1 --hub hub --to mine", "--to goes with --zoo: leave it out"),
    ("export sgan_goal.zara1 --onnx x.onnx --no-evaluation", "--no-evaluation goes with --zoo"),
    ("export best.ckpt --zoo --plan apartment.7", "--plan goes with --onnx"),
    ("export sgan_goal.zara1 --onnx .", "is a folder, expected a file"),
    ("export sgan_goal.zara1 --onnx x.onnx --plan apartmen.7", "did you mean 'apartment.7'"),
    ("export sgan_goal.zara1 --onnx x.onnx --plan flat", "sees no floor plan: leave out 'flat'"),
    ("reproduce table3", "table3"),
    ("reproduce table1 --folds etth", "unknown fold 'etth': did you mean 'eth'?"),
    ("reproduce table1 --seeds 0,1", "table1 has one seed"),
    ("reproduce table1 --maps flat", "--map"),
    ("reproduce table1 --map flat", "--map: no use for it in table1; table2, loop would have"),
    ("reproduce table2 --folds eth", "--folds: no use for it in table2; table1, forecasting would have"),
    ("reproduce table2 --models orka", "unknown policy 'orka': did you mean 'orca'?"),
    ("reproduce table2 --map apartmint.1", "did you mean 'apartment.1'?"),
    ("reproduce figure4 --seeds one", "--seeds one: expected whole numbers"),
    ("reproduce figure4 --workers 0", "workers 0: expected at least 1"),
    ("reproduce crowdnav --seeds 1", "seeds of its cases"),
    ("reproduce crowdnav --episodes 0", "expected 1 to 500"),
    ("reproduce crowdnav --models samplin", "did you mean 'sampling'"),
    ("reproduce crowdnav --physics torch", "no use for it in crowdnav"),
]
"""Other mistakes, which the commands find themselves; more are in the tests of what they call."""

FIT = "fit --config sgan_goal --data.fold embedded --rollout.episodes=1 --trainer.limit_val_batches=1"
LOOP = "fit --config closed_loop/approach_net_goal_map --weights sgan_goal.zara1 --data.fold embedded"
LOOP += ' --rollout.scenarios [hallway] --model.steps=3 --model.courses [{"scenario":"hallway"}]'
ROBOT = "fit --config robot/ppo --model.scenarios=[crowdnav:crowds=8] --trainer.max_epochs=1 --model.envs=8"
ROBOT += " --model.episodes=4 --model.steps=4 --model.updates=2 --trainer.check_val_every_n_epoch=1"
TRAININGS = {
    f"{FIT} --wandb offline": [
        ("--lr 1e-3", "did you mean --model.lr?"),
        ("--model.generator.noise_dm 4", "did you mean --model.generator.architecture.noise_dim?"),
        ("--model.discriminator.knd local", "did you mean --model.discriminator.kind?"),
        ("--data.bach_size 4", "--data.bach_size: did you mean --data.loading.batch_size?"),
        ("--trainer.max_epoch 4", "did you mean --trainer.max_epochs?"),
        ("--model.lr fast", "--model.lr: expected float, not 'fast'"),
        ("--model.clip -2", "--model.clip -2.0: expected at least 0"),
        ("--trainer.check_val_every_n_epoch 0", "--trainer.check_val_every_n_epoch 0: expected at least 1"),
        ("--trainer.accelerator foo", "invalid accelerator name: `accelerator='foo'`"),
        ("--trainer.strategy foo", "invalid strategy name: `strategy='foo'`"),
        ("--model.generator.architecture.noise_dim x", "architecture.noise_dim: expected int, not 'x'"),
        ("--data.loading.batch_size 1.5", "--data.loading.batch_size: expected int, not '1.5'"),
        ("--model GANModul", "--model: no class 'GANModul'"),
        ("stray", "unexpected argument 'stray'"),
        ("--ckpt_path none.ckpt", "no checkpoint 'none.ckpt'"),
        ("--data.loading.seed 3", "seed_everything"),
        ("--data.obs_len 6", "people walk by the last 8 steps, and --data.obs_len is 6"),
        ("--rollout.scenarios dor", "unknown scenario 'dor': did you mean 'door'?"),
        ("--rollout.scenarios door:wide=2", "unknown setting of scenario door 'wide'"),
        ("--rollout.scenarios door,door", "'door' is given twice"),
        ("--rollout.physics bulet", "did you mean 'bullet'?"),
        ("--rollout.every 0", "--rollout.every 0"),
        ("--rollout.episodes 0", "--rollout.episodes 0"),
        ("--rollout.evry 2", "did you mean --rollout.every?"),
        ("--monitor rollout/door/sucess", "did you mean 'rollout/door/success'?"),
        ("--monitor rollout/circle/success", "rollout/circle/success"),
        ("--monitor rollout/door/success", "its best value is the max: add --monitor_mode max"),
        ("--monitor rollout/door/deadlock --monitor_mode=max", "add --monitor_mode min"),
        ("--monitor rollout/door/success --rollout.scenarios null", "set --rollout.scenarios"),
    ],
    LOOP: [
        ("--model.walking.person_distanse 3", "person_distance"),
        ("--model.walking.person_distance -1", "person_distance -1.0: expected at least 0"),
        ("--model.walking.person_distance much", "walking"),
        ("--model.imitation.samples 0", "samples 0"),
        ('--model.imitation.features {"sped":1}', "did you mean 'speed'?"),
        ("--model.steps 0", "steps 0"),
        ("--model.courses []", "no courses: expected at least one scenario"),
        ('--model.courses [{"scenario":"dor"}]', "did you mean 'door'?"),
        ('--model.courses [{"scenario":"door:widht=1"}]', "did you mean 'width'?"),
        ('--model.courses [{"scenario":"door","scenes":0}]', "scenes 0, share 1.0: expected"),
        ('--model.courses [{"scenario":"door","shares":2}]', "courses"),
        ("--data.imitated.steps 0", "set --data.imitated.steps, such as 12"),
    ],
    ROBOT: [
        ("--model.robot=diff_drv", "did you mean 'diff_drive'?"),
        ("--trainer.accelerator=foo", "invalid accelerator name"),
        ("--monitor=val/retrn", "did you mean 'val/return'?"),
        ("--model.people=orcaa", "pedzoo: --model.people orcaa: no use"),
    ],
}
"""Mistakes in the options of trainings, which begin with the same words."""

VALUES += [(f"{fit} {options}", said) for fit, rows in TRAININGS.items() for options, said in rows]


@pytest.fixture(autouse=True)
def files(elsewhere: Path) -> None:
    """Write what the command lines name."""
    Path("wrong.csv").write_text("frame,person,x,y\n0,1,2,3\n")
    Path("code.py").write_text(OWN)
    Path("based.yaml").write_text("base: sgan_gaol\n")
    Path("empty.yaml").touch()
    Path("full.png").mkdir()


def test_misspelt_names_import_nothing_heavy() -> None:
    code = (
        "import sys; from pedzoo.cli.main import main;"
        "codes = {main(line.split()) for line in sys.argv[1:]}; assert codes == {2}, codes;"
        f"heavy = {HEAVY} & set(sys.modules); assert not heavy, heavy"
    )
    lines = [line for line, _ in NAMES]
    done = subprocess.run([sys.executable, "-c", code, *lines], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for (line, message), said in zip(NAMES, done.stderr.splitlines(), strict=True):
        assert said.startswith("pedzoo: ") and message in said, line


@pytest.mark.parametrize(("line", "message"), VALUES)
def test_mistakes_in_values_are_one_line(line: str, message: str, refused, monkeypatch) -> None:
    monkeypatch.delenv("PEDZOO_DATA", raising=False)
    if line.startswith(("rollout", "evaluate", "reproduce")):
        monkeypatch.setattr("pedzoo.sim.env.PedestrianEnv._step", lambda *_: pytest.fail("somebody walks"))
    if "--plan" in line:
        pytest.importorskip("onnxruntime", reason="needs pedzoo[onnx]")
    before = set(Path().iterdir())
    error = refused(*line.split())
    assert message in error and "Base" not in error
    assert set(Path().iterdir()) == before


DOUBTFUL = [
    "rollout orca:radius=0.3 file.py:Mine --scenario door:width=0.9,people=4 --video-view top",
    "rollout go_to_goal --scenario file.py:Mine:anything=1 --metrics spl,file.py:f",
    "evaluate sgan_goal.zara1:safety=false,noise=step orca:share=0.5+go_to_goal --suite encounters",
    "evaluate robot_ppo.circle stop --suite robots --people orca,replay:fold=zara1",
    "forecast hf://OWNER/REPO bent_line --data.keep_people present",
    "fit --config sgan_goal --data.files file.py --model.generator.noise_dim 4 --trainer.max_epochs=2",
    "fit --config robot/ppo --model.scenarios circle",
    "fit --model file.py --model.anything 3 --data.loading.max-pairs 9",
    "fit --model.lr 3",
    "score approach_net_goal_map.indoor walks.TSV --against zara1",
    "view goals:map=[apartment.1,office.2] orca+go_to_goal",
    "rollout --episodes 3 orca",
    "rollout orca --scenario mine.yaml:speed=1",
    "evaluate orca --people replay,replay:fold=zara1,here.py:Imported --robot here.py:Other:x=1",
    "fit --print_config",
    "validate --ckpt_path here.py",
]
"""What may be right, and is left to the command."""


def test_doubtful_names_pass() -> None:
    for line in DOUBTFUL:
        command, *words = line.split()
        check_names(command, words)


def test_too_long_names_are_one_line(refused) -> None:
    for line in ("fit --config", "fit --resume", "report"):
        assert "no file has so long a name" in refused(*line.split(), "a" * 300)


def test_odd_values_of_a_config_are_refused(elsewhere: Path) -> None:
    config = elsewhere / "odd.yaml"
    config.write_text("monitor: 2026-11-99")
    with pytest.raises(UserError, match=r"config '.*odd\.yaml' is no YAML: cannot be read: "):
        check_names("fit", ["--config", str(config)])
    config.write_text("model: 3")  # the command says what is wrong with it
    check_names("fit", ["--config", str(config)])


def test_known_options_are_those_of_the_parsers() -> None:
    code = (  # a process of its own: options of subclasses that tests define are not shipped
        "import json; from tools.pages import command_options as made;"
        "print(json.dumps([made.known(), json.loads(made.FILE.read_text())]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    known, written = json.loads(done.stdout.splitlines()[-1])
    assert written == known, "run python -m tools.pages.command_options"


def test_head_ends_a_command_without_a_traceback() -> None:
    line = f"{sys.executable} -m pedzoo models | head -1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
    assert done.stdout.count("\n") == 1 and "Traceback" not in done.stderr


def test_shells_complete_commands_options_and_names(capsys) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    expected = {"ro": "rollout", "rollout orca --scenario doo": "door", "fit --data.fo": "--data.fold"}
    for words in expected:
        asks = f"COMP_WORDS=(pedzoo {words}); COMP_CWORD={len(words.split())}; _shtab_pedzoo"
        script += f"\n{asks}; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash"], input=script, capture_output=True, text=True, check=True)
    for line, wanted in zip(done.stdout.splitlines(), expected.values(), strict=True):
        assert wanted in line.split(), done.stderr
    assert main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("#compdef pedzoo")
    assert main(["completion", "fish"]) == 2


def test_a_plugin_of_an_installed_package_is_a_command(elsewhere: Path) -> None:
    info = elsewhere / "mine-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[pedzoo.plugins]\ncommand.greet = greeting:greet\n")
    Path("greeting.py").write_text("def greet(argv):\n    print('hello', *argv)\n    return 0\n")
    command = [sys.executable, "-m", "pedzoo"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(elsewhere), str(ROOT)])}
    for words, said in ((["greet", "you"], "hello you"), (["--help"], "  greet       plugin")):
        done = subprocess.run([*command, *words], capture_output=True, text=True, env=environment)
        assert done.returncode == 0 and said in done.stdout, done.stderr
