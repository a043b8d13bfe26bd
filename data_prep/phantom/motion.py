"""From strokes and sound to the course of the pose: minimum-jerk paths, beats, nods and breath."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.gesture import REST, SHAPES, TEMPLATES, Stroke, Template
from data_prep.phantom.presenters import Style
from data_prep.phantom.skeleton import SIDES, Course
from data_prep.phantom.speech import CONTROL, Speech
from data_prep.rates import FPS

_HOLD = 0.75
"""Gaps between strokes up to this many seconds of silence are bridged by holding the pose."""

_STEP = 0.13
"""Seconds that a step of a movement lasts at least."""

_BLEND = 0.12
"""Share of a step by which it overlaps its neighbours."""

_RETURN = 0.55
"""Seconds that a hand takes back to rest."""


def minimum_jerk(share: NDArray) -> NDArray:
    """Progress of a movement at a share of its time, both in [0, 1] (Flash and Hogan 1985)."""
    s = np.clip(share, 0, 1)
    return s * s * s * (10 - 15 * s + 6 * s * s)


@dataclass
class _Path:
    """Moves of one hand through key poses (12,): x, y, z, angle, turn, fore and six of shape.

    Each move is a minimum-jerk course; moves that overlap in time add up, so that the hand turns
    the corner without a stop.
    """

    now: float
    pose: NDArray
    moves: list[tuple[float, float, NDArray, NDArray]] = field(default_factory=list)
    first: NDArray = field(init=False)

    def __post_init__(self) -> None:
        self.first = self.pose

    def to(
        self, time: float, pose: NDArray, bulge: NDArray | None = None, late: float = 0.0
    ) -> None:
        """Move from now until `time` to `pose`, bowing out by `bulge` (3,).

        The move ends `late` seconds after `time`, which is when the next may start.
        """
        if time <= self.now + 1e-6:
            raise ValueError(f"a move cannot end at {time:.3f} s and start at {self.now:.3f} s")
        bow = np.zeros(3) if bulge is None else bulge
        self.moves.append((self.now, time + late, pose - self.pose, bow))
        self.now, self.pose = time, pose

    def through(self, beats: NDArray, time: float, pose: NDArray) -> None:
        """Move from now until `time` to `pose` in steps that meet at the beats between.

        Neighbouring steps overlap, so that the hand slows down on a beat without a stop.
        """
        inside = beats[(beats > self.now + _STEP) & (beats < time - _STEP)]
        corners = [self.now]
        for beat in [*inside, time]:
            if beat - corners[-1] >= _STEP:
                corners.append(float(beat))
        corners[-1] = time
        whole, start = pose - self.pose, self.now
        for first, last in zip(corners[:-1], corners[1:], strict=True):
            blend = _BLEND * (last - first)
            early = first - (blend if first > start else 0.0)
            late = last + (blend if last < time else 0.0)
            self.moves.append((early, late, whole * (last - first) / (time - start), np.zeros(3)))
        self.now, self.pose = time, pose

    def wait(self, time: float) -> None:
        """Stay where the hand is until `time`, when that is later."""
        self.now = max(self.now, time)

    def sample(self, at: NDArray) -> NDArray:
        """Poses (n, 12) at times (n,)."""
        out = np.tile(self.first, (len(at), 1))
        for start, end, change, bow in self.moves:
            progress = minimum_jerk((at - start) / (end - start))[:, None]
            out += change * progress
            out[:, :3] += bow * np.sin(np.pi * progress) ** 2
        return out


def _pose(template: Template, apex: bool, second: bool, side: float, style: Style) -> NDArray:
    """Key pose (12,) of one hand of a template in body units."""
    place = template.apex if apex else template.prep
    if second and template.other is not None:
        place = template.other[1 if apex else 0]
    x, y, z = place
    if template is not REST:
        centre = np.array([62.0, 94.0, 80.0])
        x, y, z = centre + (np.array(place) - centre) * (0.25 + 0.75 * style.amplitude)
        y += style.height
    angle = np.radians(template.angle[1 if apex else 0])
    if side < 0:
        angle = -np.pi - angle
    head = np.array([side * x, y, z, angle, template.turn, template.fore])
    return np.concatenate([head, SHAPES[template.shape]])


def _course_of_hand(
    hand: int, strokes: list[Stroke], speech: Speech, style: Style, rng: np.random.Generator
) -> _Path:
    side = float(SIDES[hand])
    rest = _pose(REST, False, False, side, style)
    path = _Path(-1.0, rest)
    pulse, ends = speech.pulse, [end for _, end in speech.phrases]
    mine = [stroke for stroke in strokes if hand in stroke.hands]
    for number, stroke in enumerate(mine):
        template = TEMPLATES[stroke.label]
        second = stroke.hands[0] != hand
        shift = np.concatenate([rng.normal(0, 4, 3), np.zeros(9)])
        prep = _pose(template, False, second, side, style) + shift
        apex = _pose(template, True, second, side, style) + shift
        spoken = stroke.prepared in pulse
        drive = stroke.apex - stroke.prepared
        path.wait(stroke.onset)
        if spoken:
            path.through(pulse, stroke.prepared, prep)
        else:
            path.to(stroke.prepared, prep, late=0.5 * drive)
        bulge = np.array(template.bulge) * np.array([side, 1, 1]) * style.amplitude
        path.to(stroke.apex, apex, bulge)
        after = mine[number + 1].onset if number + 1 < len(mine) else np.inf
        phrase_end = ends[speech.words[stroke.word].phrase]
        last = float(pulse[pulse < phrase_end][-1])
        home, final = after - phrase_end > _HOLD, last <= stroke.apex
        if home and final:
            path.to(stroke.apex + 1.2 * _RETURN, rest)
            continue
        path.to(min(stroke.apex + 0.4, after) if final else stroke.end, apex + 0.13 * (prep - apex))
        if home:
            path.wait(max(stroke.end, min(last, stroke.end + 1.4)))
            path.to(path.now + _RETURN, rest)
    return path


def _keyed(at: NDArray, times: list[float], values: list[float]) -> NDArray:
    """Values (n,) at times (n,) of minimum-jerk moves from key to key, at rest in every key."""
    t, v = np.array(times), np.array(values)
    index = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    share = (at - t[index]) / (t[index + 1] - t[index])
    return v[index] + (v[index + 1] - v[index]) * minimum_jerk(share)


def _rhythm(
    at: NDArray, speech: Speech, accents: NDArray, pauses: list[tuple[float, float]]
) -> NDArray:
    """Rhythmic movement (n,) that comes to rest on every syllable of the pulse, zero in silence.

    Stressed syllables pull it to their accent (about 1, downwards), the others a little back and
    forth, so that its speed has a minimum on each syllable and none between.

    Args:
        at: times.
        speech: syllables and phrases.
        accents: size for each stressed syllable.
        pauses: spans of time, in order, in which there is none of this movement.
    """
    strong = dict(zip(speech.beats.tolist(), accents.tolist(), strict=True))
    keys: dict[float, float] = {-1.0: 0.0, speech.duration + 9.0: 0.0}
    for first, last in pauses:
        keys[first] = keys[last] = 0.0
    pulse = speech.pulse
    for start, end in speech.phrases:
        inside = pulse[(pulse >= start) & (pulse <= end)].tolist()
        keys[inside[0] - 0.14] = keys[inside[-1] + 0.2] = 0.0
        value = 0.0
        for syllable in inside:
            value = strong.get(syllable, -0.35 if value > 0 else 0.25)
            keys[syllable] = value
    times: list[float] = []
    for time in sorted(keys):
        paused = any(first < time < last for first, last in pauses)
        if not paused and (not times or time - times[-1] > 0.02):
            times.append(time)
    return _keyed(at, times, [keys[time] for time in times])


def _pulses(at: NDArray, beats: NDArray, size: NDArray, down: float, back: float) -> NDArray:
    """Sum (n,) of strokes that reach their size at each beat and die away after it."""
    rise = minimum_jerk((at[:, None] - beats + down) / down)
    fall = minimum_jerk((at[:, None] - beats) / back)
    return ((rise - fall) * size).sum(1)


def _wander(at: NDArray, speech: Speech, size: float, rng: np.random.Generator) -> NDArray:
    """Slow drift (n,): a new value with each phrase, zero in long silences."""
    path, now = np.zeros(len(at)), 0.0
    spans = speech.phrases
    for index, (start, end) in enumerate(spans):
        goal = float(rng.normal(0, size))
        path += (goal - now) * minimum_jerk((at - start - 0.08) / 0.7)
        now = goal
        quiet = index + 1 == len(spans) or spans[index + 1][0] - end > _HOLD
        if quiet:
            path += -now * minimum_jerk((at - end + 0.15) / 0.6)
            now = 0.0
    return path


def _face(at: NDArray, speech: Speech, accents: NDArray, rng: np.random.Generator) -> NDArray:
    """Eyelids, brows, mouth gap and mouth width (n, 4)."""
    blinks, now = [], float(rng.uniform(0.3, 2.5))
    while now < speech.duration:
        blinks.append(now)
        now += float(rng.uniform(1.8, 5.0))
    closed = _pulses(at, np.array(blinks), np.ones(len(blinks)), 0.09, 0.16)
    strong = rng.random(len(accents)) < 0.3
    size = strong * rng.uniform(0.4, 1.0, len(accents))
    lift = 0.12 + _pulses(at, accents, size, 0.2, 0.45)
    ticks = (np.arange(len(speech.opening)) + 0.5) / CONTROL
    samples = speech.samples.reshape(len(speech.opening), -1)
    loud = np.sqrt((samples**2).mean(1))
    loud = np.minimum(loud / max(float(np.percentile(loud, 92)), 1e-6), 1.2) ** 0.6
    loud = np.convolve(loud, np.hanning(9) / np.hanning(9).sum(), "same")
    gap = np.interp(at, ticks, speech.opening * (0.25 + 0.75 * loud))
    width = 0.55 + np.interp(at, ticks, (speech.spread - 0.55) * (speech.opening > 0.02))
    return np.stack([closed, lift, gap, width], 1)


def course(speech: Speech, strokes: list[Stroke], style: Style, rng: np.random.Generator) -> Course:
    """The pose in every frame of the speech.

    Hands follow the strokes and, between them, beat a little on every stressed syllable that has
    no stroke; the head nods with the accents; body and head drift with each phrase; in silence
    nothing but the breath moves.

    Args:
        speech: words, beats and mouth.
        strokes: as `gesture.schedule` gives them.
        style: of the presenter.
        rng: source of randomness.
    """
    frames = round(speech.duration * FPS)
    at = np.arange(frames) / FPS
    beats = speech.beats
    accents = rng.uniform(0.6, 1.2, len(beats))
    hands = []
    for hand in (0, 1):
        pose = _course_of_hand(hand, strokes, speech, style, rng).sample(at)
        busy = [(s.onset, s.end) for s in strokes if hand in s.hands]
        share = 1.0 if hand == (0 if style.right_hand >= 0.5 else 1) else 0.6
        raised = np.clip((140 - pose[:, 1]) / 40, 0, 1)
        reach = share * style.bounce * (6.0 + 5.0 * raised)
        pose[:, 1] += reach * _rhythm(at, speech, accents, busy)
        hands.append(pose)
    both = np.stack(hands, 1)
    breath = np.sin(2 * np.pi * (0.27 * at + rng.random()))
    nod = style.nod * _rhythm(at, speech, accents, [])
    head = np.stack([
        _wander(at, speech, 0.10, rng),
        0.13 * nod + _wander(at, speech, 0.04, rng),
        _wander(at, speech, 0.035, rng) + 0.01 * nod,
    ], 1)  # fmt: skip
    sway = np.stack([
        _wander(at, speech, 4.0 * style.sway, rng), 0.4 * breath + 1.3 * nod,
    ], 1)  # fmt: skip
    lean = _wander(at, speech, 0.014 * style.sway, rng)
    return Course(
        sway=sway.astype(np.float32),
        lean=lean.astype(np.float32),
        head=head.astype(np.float32),
        wrists=both[:, :, :3].astype(np.float32),
        angle=both[:, :, 3].astype(np.float32),
        turn=both[:, :, 4].astype(np.float32),
        fore=both[:, :, 5].astype(np.float32),
        shape=both[:, :, 6:].astype(np.float32),
        face=_face(at, speech, beats, rng).astype(np.float32),
    )
