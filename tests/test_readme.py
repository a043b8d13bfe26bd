"""The READMEs: their commands parse, their Python runs, and what they name exists."""

import argparse
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCRIPTS = ROOT / "scripts"
CHECK = runpy.run_path(str(SCRIPTS / "check_readme.py"))
READMES = CHECK["READMES"]


def text_of(readme):
    return (ROOT / readme).read_text(encoding="utf-8")


def prose(readme):
    """A README without its code blocks."""
    return re.sub(r"^```.*?^```", "", text_of(readme), flags=re.DOTALL | re.MULTILINE)


def inline(readme):
    """What stands between backquotes, on one line."""
    return [" ".join(part.split()) for part in re.findall(r"`([^`]+)`", prose(readme))]


def every_command():
    found = {}
    for readme in READMES:
        for command in CHECK["commands"](text_of(readme)):
            found.setdefault(command, readme)
    return sorted(found)


COMMANDS = every_command()


OF_OTHERS = {"--help", "--logdir"}
"""Options that neither the command nor the scripts define themselves."""


ENDINGS = (".py", ".sh", ".json", ".safetensors")
"""Of files, whose names look like those of settings."""


class Parsed(Exception):
    """Raised in place of what a script does once it has read its arguments."""


def parse_angie(words):
    """Read a command line as `angie` does, without running it."""
    import typer

    from angie.cli import app

    group = typer.main.get_command(app)
    command = group.commands[words[0]]
    command.make_context(words[0], list(words[1:]))


def test_every_readme_is_known():
    there = {str(path.relative_to(ROOT)) for path in ROOT.glob("[!.]*/**/README.md")}
    assert there | {"README.md"} == set(READMES)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("angie ")])
def test_command_parses(command):
    parse_angie(CHECK["plain"](command)[1:])


def test_a_wrong_command_does_not_parse():
    with pytest.raises(Exception, match="no such option|No such option"):
        parse_angie(["animate", "photo.jpg", "speech.wav", "-o", "out.mp4", "--sped", "2"])


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("python ")])
def test_script_parses(command, monkeypatch):
    words, _ = CHECK["filled"](command, 1)
    parser = argparse.ArgumentParser

    def stopped(read):
        def stop(*given):
            raise Parsed(read(*given))

        return stop

    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(SCRIPTS))
    monkeypatch.setattr(sys, "argv", words[1:])
    monkeypatch.setattr(parser, "parse_intermixed_args", stopped(parser.parse_intermixed_args))
    monkeypatch.setattr(parser, "parse_args", stopped(parser.parse_args))
    with pytest.raises(Parsed):
        runpy.run_path(str(ROOT / words[1]), run_name="__main__")


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("bash ")])
def test_shell_script_parses(command):
    subprocess.run(["bash", "-n", str(ROOT / command.split()[1])], check=True)


def test_every_command_and_script_is_in_a_readme():
    from angie.cli import app

    names = {one.callback.__name__.replace("_", "-") for one in app.registered_commands}
    told = {words.split()[1] for words in CHECK["commands"](text_of("README.md"))}
    assert names <= told
    scripts = {path.name for path in SCRIPTS.glob("*.sh")}
    scripts |= {path.name for path in SCRIPTS.glob("*.py") if "__main__" in path.read_text()}
    told = CHECK["commands"](text_of("scripts/README.md"))
    assert scripts == {Path(command.split()[1]).name for command in told}


def options_of_angie():
    import typer

    from angie.cli import app

    commands = typer.main.get_command(app).commands.values()
    return {name for command in commands for one in command.params for name in one.opts}


def is_setting(name):
    """Whether the preset, or ANGIE's part of it, has a setting of this name."""
    from angie.config import preset

    whole = preset("paper")
    for value in (whole, whole.settings("angie")):
        for part in name.split("."):
            value = getattr(value, part, None)
        if value is not None:
            return True
    return False


def test_settings_of_the_recipes_exist():
    text = "".join(path.read_text() for path in SCRIPTS.glob("*.sh"))
    named = set(
        re.findall(r"\b((?:renderer|vq|gpt|refiner|generation|train_\w+)\.[a-z_.]+)=", text)
    )
    assert len(named) > 30
    assert [name for name in sorted(named) if not is_setting(name)] == []
    assert not is_setting("train_vq.schedule.most_stepps")


@pytest.mark.parametrize("readme", READMES)
def test_options_settings_and_files_exist(readme):
    scripts = "".join(path.read_text() for path in SCRIPTS.glob("*.py"))
    known = options_of_angie() | set(re.findall(r'"(--[a-z-]+)"', scripts)) | OF_OTHERS
    for words in inline(readme):
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", words):
            assert option in known, f"{option} in {words}"
        part = r"(renderer|vq|gpt|refiner|generation|train_\w+)(\.[a-z_]+)+(=.*)?"
        if re.fullmatch(part, words) and not words.endswith(ENDINGS):
            assert is_setting(words.split("=")[0]), words
        if re.fullmatch(r"[\w./]+\.py", words):
            assert [path for path in ROOT.rglob(words.split("/")[-1]) if str(path).endswith(words)]
    for target in re.findall(r"\]\(([^)#]+)\)", prose(readme)):
        assert ((ROOT / readme).parent / target).exists(), target


def test_the_front_page_is_short():
    assert (ROOT / "README.md").stat().st_size <= 9000
    assert (ROOT / "angie/default/strip.jpg").stat().st_size < 300_000


def test_the_python_example_runs(tmp_path, monkeypatch, capsys):
    import imageio.v3 as imageio
    import soundfile

    from angie.bundle import PHOTO, SPEECH

    example = re.search(r"^```python\n(.*?)^```", text_of("README.md"), re.DOTALL | re.MULTILINE)
    samples, rate = soundfile.read(SPEECH, stop=16_000)
    soundfile.write(tmp_path / "speech.wav", samples, rate)
    imageio.imwrite(tmp_path / "photo.jpg", imageio.imread(PHOTO))
    monkeypatch.chdir(tmp_path)
    exec(compile(example[1], "README.md", "exec"), {})
    frames = -(-len(samples) * 25 // rate)
    *chunks, motion = capsys.readouterr().out.split("\n")[:-1]
    assert motion == f"torch.Size([{frames}, 20, 2])"
    assert all(chunk.endswith(", 256, 256, 3)") for chunk in chunks)
    assert sum(int(chunk[1:].split(",")[0]) for chunk in chunks) == frames
    assert (tmp_path / "out.mp4").stat().st_size > 1000
