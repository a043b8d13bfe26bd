import csv

import cv2
import numpy as np
import pytest

from data_prep.errors import BadInput
from mraa.training.curves import PANEL, Curves, draw_curves


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
    picture = cv2.imread(str(tmp_path / "toy.png"))
    assert picture.shape == (PANEL[1], 2 * PANEL[0], 3)
    assert list((tmp_path / "toy").glob("events*"))


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


def test_a_falling_curve_falls_in_the_picture():
    picture = draw_curves({"loss": [(i, 2.0 - i / 50) for i in range(50)]}).astype(int)
    panel = picture[31:214, 75 : PANEL[0] - 20]
    blue = (panel[..., 2] - panel[..., 0]) > 80
    heights = [np.flatnonzero(blue[:, x]).mean() for x in (10, 200, 370)]
    assert heights[0] < heights[1] < heights[2]  # rows are counted from the top


def test_no_points_and_no_numbers_are_drawn_too():
    assert draw_curves({}).shape == (PANEL[1], 2 * PANEL[0], 3)
    nothing = draw_curves({"loss": [(0, float("nan"))], "one": [(3, 5.0)]})
    assert nothing.shape == (PANEL[1], 2 * PANEL[0], 3)
