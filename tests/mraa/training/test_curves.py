import csv
from importlib.util import find_spec

import imageio.v3 as iio
import numpy as np
import pytest

from data_prep.errors import BadInput
from mraa.training.curves import Curves, draw_curves


def rows(path):
    with path.open() as file:
        return [(r["name"], int(r["step"]), float(r["value"])) for r in csv.DictReader(file)]


def test_resumed_curves_keep_what_was_before_and_drop_what_is_made_again(tmp_path):
    curves = Curves(tmp_path, "toy", 0)
    for step in (0, 10, 20):
        curves.add(step, {"loss": 1.5 + step})
    curves.write()
    curves.close()
    again = Curves(tmp_path, "toy", 20)
    again.add(20, {"loss": 9.0, "late": 2.0})
    again.write()
    again.close()
    wanted = [("loss", 0, 1.5), ("loss", 10, 11.5), ("loss", 20, 9.0), ("late", 20, 2.0)]
    assert rows(tmp_path / "toy.csv") == wanted
    assert iio.imread(tmp_path / "toy.png").shape[:2] == (240, 960)
    assert bool(list((tmp_path / "toy").glob("events*"))) == bool(find_spec("tensorboard"))


def test_a_new_training_forgets_the_old_curves(tmp_path):
    for value in (1.0, 2.0):
        curves = Curves(tmp_path, "toy", 0)
        curves.add(0, {"loss": value})
        curves.write()
        curves.close()
    assert rows(tmp_path / "toy.csv") == [("loss", 0, 2.0)]


def test_a_damaged_table_is_told(tmp_path):
    (tmp_path / "toy.csv").write_text("step,name,value\nx,loss,1\n")
    with pytest.raises(BadInput, match="damaged"):
        Curves(tmp_path, "toy", 5)


def test_a_falling_curve_falls_in_the_picture(tmp_path):
    path = tmp_path / "curves.png"
    draw_curves({"loss": [(i, 2.0 - i / 50) for i in range(50)]}, path)
    picture = iio.imread(path)[..., :3].astype(int)
    blue = (picture[..., 2] - picture[..., 0]) > 80
    columns = np.flatnonzero(blue.any(0))
    heights = [np.flatnonzero(blue[:, x]).mean() for x in columns[[5, len(columns) // 2, -5]]]
    assert len(columns) > 200 and heights[0] < heights[1] < heights[2]  # rows count from the top


def test_no_points_and_no_numbers_are_drawn_too(tmp_path):
    draw_curves({}, tmp_path / "none.png")
    points = {"loss": [(0, float("nan"))], "one": [(3, 5.0)], "wide": [(0, 1.0), (1, 100.0)]}
    draw_curves(points, tmp_path / "some.png")
    none, some = (iio.imread(tmp_path / f"{name}.png") for name in ("none", "some"))
    assert none.shape[:2] == (240, 960) and some.shape[:2] == (480, 960)
    assert none.min() == 255 and some.min() < 100


def test_curves_do_without_tensorboard(tmp_path, monkeypatch):
    monkeypatch.setattr("mraa.training.curves.find_spec", lambda name: None)
    folder = tmp_path / "train" / "curves"  # is made
    curves = Curves(folder, "toy", 0)
    curves.add(0, {"loss": 1.5})
    curves.image("samples", np.zeros((8, 8, 3), np.uint8), 0)
    curves.write()
    curves.close()
    assert sorted(path.name for path in folder.iterdir()) == ["toy.csv", "toy.png"]
