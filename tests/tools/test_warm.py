"""`mjgranular warm`: what was compiled ahead is not compiled again."""

import logging

import pytest

from mjgranular.cli import main

XML = (
    '<mujoco><option timestep="1e-4"/><worldbody><geom type="plane" size="1 1 .1"/>'
    '<body pos="0 0 1"><freejoint/><geom type="capsule" size=".01 .1"/></body></worldbody></mujoco>'
)


class Compiled(logging.Handler):
    def __init__(self):
        super().__init__()
        self.sands = []

    def emit(self, record):
        if hasattr(record, "sand"):
            self.sands.append(record.sand)


@pytest.fixture
def compiled():
    handler, logger = Compiled(), logging.getLogger("mjgranular.kernel")
    logger.addHandler(handler)
    yield handler.sands
    logger.removeHandler(handler)


def test_a_law_and_a_scheme(compiled, capsys):
    arguments = ["warm", "--law", "link", "--scheme", "explicit"]
    assert main(arguments) == 0
    text = capsys.readouterr().err
    assert "ready: law link, scheme explicit (" in text
    assert "ready: law link, scheme explicit, inside mj_step (" in text
    compiled.clear()
    assert main(arguments) == 0
    assert compiled == []


def test_a_model(compiled, tmp_path, capsys):
    path = tmp_path / "robot.xml"
    path.write_text(XML)
    assert main(["warm", str(path), "--law", "link", "--scheme", "explicit"]) == 0
    text = capsys.readouterr().err
    assert "ready: robot.xml and Sand (" in text
    assert "ready: robot.xml and mj_step (" in text
    assert "warning" not in text
    compiled.clear()
    drop = ["drop", str(path), "--law", "link", "--scheme", "explicit"]
    assert main([*drop, "--keep-floor", "--duration", "1e-3"]) == 0
    assert compiled == []


def test_an_environment(capsys):
    assert main(["warm", "--env", "LinkDrop"]) == 0
    assert "ready: LinkDrop (" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--law", "lnk"], "no law 'lnk'"),
        (["--scheme", "magic"], "no scheme 'magic'"),
        (["--env", "Nowhere-v9"], "no environment 'Nowhere-v9'"),
        (["robot.xml", "--env", "LinkDrop"], "not both"),
        (["nowhere.xml"], "nowhere.xml"),
    ],
)
def test_mistakes(capsys, arguments, said):
    assert main(["warm", *arguments]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
