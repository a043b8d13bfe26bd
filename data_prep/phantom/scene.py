"""Where the presenter sits or stands: backgrounds, the desk, light fall-off and lens."""

import cv2
import numpy as np

from data_prep.phantom.paint import Array, blur, bump, noise, wood
from data_prep.phantom.presenters import Setting

HEIGHT, WIDTH = 360, 640
"""Size of the picture in pixels."""

DESK_ROW = 321
"""Row of the far edge of the desk."""


def _tone(rng: np.random.Generator, low: float = 0.35, high: float = 0.8) -> Array:
    grey = rng.uniform(low, high)
    tint = rng.uniform(-0.13, 0.13, 3)
    return np.clip(grey + tint - tint.mean(), 0.08, 0.95).astype(np.float32)


def _box(image: Array, box: tuple[float, float, float, float], colour: Array) -> None:
    x0, y0, x1, y1 = (int(round(v)) for v in box)
    cv2.rectangle(image, (x0, y0), (x1, y1), tuple(float(c) for c in colour), -1)


def _wall(rng: np.random.Generator) -> Array:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    plaster = 1 + 0.02 * noise(rng, HEIGHT, WIDTH, 0.6) + 0.03 * noise(rng, HEIGHT, WIDTH, 1.8)
    image = np.ascontiguousarray(_tone(rng, 0.45, 0.85) * plaster[..., None], np.float32)
    for _ in range(int(rng.integers(0, 4))):
        cx, cy = rng.uniform(30, WIDTH - 30), rng.uniform(40, 170)
        w, h = rng.uniform(28, 60), rng.uniform(28, 50)
        _box(image, (cx - w + 4, cy - h + 6, cx + w + 4, cy + h + 6), image.mean((0, 1)) * 0.7)
        _box(image, (cx - w, cy - h, cx + w, cy + h), _tone(rng, 0.1, 0.4))
        _box(image, (cx - w + 6, cy - h + 6, cx + w - 6, cy + h - 6), _tone(rng, 0.6, 0.95))
        _box(image, (cx - w * 0.5, cy - h * 0.5, cx + w * 0.5, cy + h * 0.5), _tone(rng))
    if rng.random() < 0.5:
        _plant(image, rng, float(rng.choice([60, WIDTH - 60])))
    return image


def _plant(image: Array, rng: np.random.Generator, cx: float) -> None:
    green = np.array([0.2, 0.42, 0.2]) * rng.uniform(0.7, 1.3)
    for _ in range(46):
        angle, reach = rng.uniform(-2.6, -0.5), rng.uniform(20, 120)
        at = (int(cx + reach * np.cos(angle)), int(250 + reach * np.sin(angle)))
        axes = (int(rng.integers(12, 24)), int(rng.integers(4, 9)))
        colour = tuple(float(c) for c in green * rng.uniform(0.6, 1.3))
        cv2.ellipse(image, at, axes, float(np.degrees(angle)), 0, 360, colour, -1, cv2.LINE_AA)
    _box(image, (cx - 26, 250, cx + 26, 330), _tone(rng, 0.5, 0.9))


def _shelf(rng: np.random.Generator) -> Array:
    timber = np.array([0.45, 0.31, 0.2], np.float32) * rng.uniform(0.5, 1.5)
    image = wood(rng, HEIGHT, WIDTH, np.clip(timber, 0, 0.9) * 0.55)
    board = int(rng.integers(84, 120))
    for top in range(-30, HEIGHT, board):
        x = -5.0
        while x < WIDTH:
            wide, tall = rng.uniform(7, 20), rng.uniform(0.55, 0.86) * board
            if rng.random() < 0.12:
                x += rng.uniform(15, 50)
                continue
            colour = _tone(rng, 0.15, 0.75)
            base = top + board - 8
            _box(image, (x, base - tall, x + wide - 2, base), colour)
            _box(image, (x, base - tall, x + 2, base), colour * 0.7)
            _box(image, (x + 2, base - tall * 0.8, x + wide - 4, base - tall * 0.7), colour * 1.4)
            x += wide
        _box(image, (0, top + board - 8, WIDTH, top + board), np.clip(timber * 1.2, 0, 0.9))
    return image


def _curtain(rng: np.random.Generator) -> Array:
    x = np.arange(WIDTH, dtype=np.float32)[None, :]
    y = np.arange(HEIGHT, dtype=np.float32)[:, None]
    bend = 6 * np.sin(y / 130 + rng.uniform(0, 6)) + 8 * noise(rng, 1, WIDTH, 1.5)
    fold = np.sin((x + bend) / rng.uniform(8, 17)) + 0.4 * np.sin((x + bend) / 5.3 + 1)
    tone = 0.78 + 0.17 * fold + 0.03 * noise(rng, HEIGHT, WIDTH, 0.6)
    return (_tone(rng, 0.3, 0.75) * tone[..., None]).astype(np.float32)


def _studio(rng: np.random.Generator) -> Array:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    cx, cy = rng.uniform(200, 440), rng.uniform(80, 220)
    glow = bump(x, y, float(cx), float(cy), rng.uniform(150, 300), rng.uniform(110, 200))
    cloudy = 1 + 0.07 * noise(rng, HEIGHT, WIDTH, 1.7)
    colour = _tone(rng, 0.3, 0.7)
    image = colour * ((0.35 + 0.75 * glow) * cloudy)[..., None]
    return image.astype(np.float32)


def _bokeh(rng: np.random.Generator) -> Array:
    image = np.empty((HEIGHT, WIDTH, 3), np.float32)
    image[:] = _tone(rng, 0.12, 0.35)
    image *= (1 + 0.25 * noise(rng, HEIGHT, WIDTH, 1.9))[..., None]
    for _ in range(int(rng.integers(40, 90))):
        disc = np.zeros((HEIGHT, WIDTH), np.float32)
        centre = (int(rng.integers(0, WIDTH)), int(rng.integers(0, HEIGHT)))
        cv2.circle(disc, centre, int(rng.integers(7, 26)), (1.0,), -1, cv2.LINE_AA)
        image += (disc * float(rng.uniform(0.05, 0.4)))[..., None] * _tone(rng, 0.5, 0.9)
    return np.minimum(image, 1)


def _brick(rng: np.random.Generator) -> Array:
    colour = np.array([0.55, 0.33, 0.26], np.float32) * rng.uniform(0.6, 1.3)
    if rng.random() < 0.4:
        colour = _tone(rng, 0.6, 0.85)
    image = np.empty((HEIGHT, WIDTH, 3), np.float32)
    image[:] = np.clip(colour * 0.72 + 0.12, 0, 1)
    tall, wide = float(rng.uniform(16, 26)), float(rng.uniform(42, 64))
    for row in range(int(HEIGHT / tall) + 1):
        for column in range(-1, int(WIDTH / wide) + 1):
            x, y = (column + 0.5 * (row % 2)) * wide, row * tall
            tone = np.clip(colour * rng.uniform(0.8, 1.15), 0, 1)
            _box(image, (x + 1, y + 1, x + wide - 2, y + tall - 2), tone)
    return image * (1 + 0.07 * noise(rng, HEIGHT, WIDTH, 0.7))[..., None]


def _window(rng: np.random.Generator) -> Array:
    image = _wall(rng)
    x0, x1 = rng.uniform(40, 200), rng.uniform(420, 600)
    y1 = rng.uniform(190, 300)
    sky = np.linspace(0, 1, HEIGHT, dtype=np.float32)[:, None, None]
    view = (1 - sky) * np.array([0.62, 0.78, 0.95], np.float32) + sky * _tone(rng, 0.5, 0.8)
    view = np.ascontiguousarray(np.broadcast_to(view, image.shape), np.float32).copy()
    for _ in range(12):
        x, w = rng.uniform(0, WIDTH), rng.uniform(15, 50)
        _box(view, (x, rng.uniform(70, 200), x + w, HEIGHT), _tone(rng, 0.3, 0.7))
    view = blur(view * (1 + 0.05 * noise(rng, HEIGHT, WIDTH, 1.2))[..., None], 4)
    rows, columns = slice(10, int(y1)), slice(int(x0), int(x1))
    frame = _tone(rng, 0.6, 0.95)
    _box(image, (x0 - 8, 2, x1 + 8, y1 + 8), frame)
    image[rows, columns] = view[rows, columns]
    for x in np.linspace(x0, x1, int(rng.integers(2, 5)) + 1)[1:-1]:
        _box(image, (x - 4, 2, x + 4, y1), frame)
    return image


def _mural(rng: np.random.Generator) -> Array:
    fields = [noise(rng, HEIGHT, WIDTH, s) for s in (1.3, 1.6, 1.1)]
    image = np.empty((HEIGHT, WIDTH, 3), np.float32)
    image[:] = _tone(rng, 0.35, 0.7)
    image += 0.14 * fields[0][..., None] * _tone(rng) + 0.12 * fields[1][..., None] * _tone(rng)
    edges = (fields[2] > rng.uniform(-0.5, 0.8)).astype(np.float32)
    return image * (0.75 + 0.25 * blur(edges, 1.5))[..., None]


_PLACES = {
    "wall": _wall, "shelf": _shelf, "curtain": _curtain, "studio": _studio,
    "bokeh": _bokeh, "brick": _brick, "window": _window, "mural": _mural,
}  # fmt: skip


def background(place: Setting, rng: np.random.Generator) -> Array:
    """The background (HEIGHT, WIDTH, 3), out of focus and lit from the light's side."""
    image = blur(np.ascontiguousarray(_PLACES[place.place](rng), np.float32), rng.uniform(0.8, 4))
    x = np.linspace(-1, 1, WIDTH, dtype=np.float32)[None, :]
    y = np.linspace(-1, 1, HEIGHT, dtype=np.float32)[:, None]
    fall = 1 + 0.28 * place.light[0] * x + 0.2 * place.light[1] * y
    return np.clip(image * fall[..., None], 0.01, 1).astype(np.float32)


def desk(place: Setting, rng: np.random.Generator) -> Array:
    """The desk's rows (HEIGHT - DESK_ROW, WIDTH, 3), its far edge first."""
    height = HEIGHT - DESK_ROW
    colour = np.array([0.55, 0.4, 0.28], np.float32) * np.float32(rng.uniform(0.45, 1.5))
    if rng.random() < 0.35:
        colour = _tone(rng, 0.15, 0.85)
    top = wood(rng, height, WIDTH, np.clip(colour, 0.05, 0.9))
    depth = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, WIDTH, dtype=np.float32)[None, :]
    light = 0.82 + 0.2 * depth + 0.2 * place.light[0] * x
    top *= light[..., None]
    top[:2] *= 1.18
    return np.clip(top, 0, 1)


def lens(place: Setting, rng: np.random.Generator) -> Array:
    """What multiplies every picture (HEIGHT, WIDTH, 3): vignette, exposure, colour temperature."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    radius = np.hypot((x - WIDTH / 2) / WIDTH, (y - HEIGHT / 2) / WIDTH)
    shade = 1 - float(rng.uniform(0.25, 0.8)) * radius**2
    tint = np.array([1 + 0.07 * place.warmth, 1, 1 - 0.09 * place.warmth], np.float32)
    return (place.exposure * shade[..., None] * tint).astype(np.float32)
