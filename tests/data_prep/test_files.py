import pytest

from data_prep.errors import BadInput
from data_prep.files import alone, check_apart, check_output, whole_file, whole_folder


def test_a_file_appears_whole(tmp_path):
    path = tmp_path / "out.txt"
    with whole_file(path) as part:
        part.write_text("new")
        assert not path.exists() and part.parent == tmp_path
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_nothing_and_keeps_the_old(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), whole_file(path, force=True) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_an_existing_output_needs_force(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(BadInput, match="--force"):
        check_output(path)
    with pytest.raises(BadInput, match="does not exist"):
        check_output(tmp_path / "none" / "out.txt")
    with pytest.raises(BadInput, match="is a folder"), whole_file(tmp_path, force=True):
        raise AssertionError("not reached")


def test_a_folder_of_the_same_kind_is_replaced(tmp_path):
    path = tmp_path / "made"
    for text in ("one", "two"):
        with whole_folder(path, mark="mark.json", force=True) as part:
            (part / "mark.json").write_text(text)
            (part / text).touch()
    assert sorted(p.name for p in path.iterdir()) == ["mark.json", "two"]
    assert list(tmp_path.iterdir()) == [path]


def test_another_folder_is_never_replaced(tmp_path):
    path = tmp_path / "mine"
    path.mkdir()
    (path / "letter").touch()
    with (
        pytest.raises(BadInput, match="holds other things"),
        whole_folder(path, mark="mark.json", force=True),
    ):
        raise AssertionError("not reached")
    assert (path / "letter").exists()


def test_an_output_must_not_be_an_input(tmp_path):
    video = tmp_path / "videos" / "a.mp4"
    for output in (video, video.parent, tmp_path):
        with pytest.raises(BadInput, match="would replace the input"):
            check_apart(output, [video])
    check_apart(tmp_path / "videos" / "b.mp4", [video])


def test_only_one_command_is_at_work_in_an_output(tmp_path):
    output = tmp_path / "bundle"
    with alone(output):
        with pytest.raises(BadInput, match="another command is at work in it"):
            with alone(output):
                pass
        assert [path.name for path in tmp_path.iterdir()] == [".bundle.lock"]
    assert not list(tmp_path.iterdir())
    with alone(output):
        pass


def test_what_has_been_made_meanwhile_is_not_replaced(tmp_path):
    with pytest.raises(BadInput, match="exists already"):
        with whole_file(tmp_path / "a.txt") as part:
            part.write_text("mine")
            (tmp_path / "a.txt").write_text("theirs")
    assert (tmp_path / "a.txt").read_text() == "theirs"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
