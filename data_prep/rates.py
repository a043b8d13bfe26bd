"""Every rate and size of the project, derived from four numbers."""


def _exact(numerator: int, denominator: int) -> int:
    quotient, remainder = divmod(numerator, denominator)
    if remainder:
        raise ValueError(f"{numerator} is not a multiple of {denominator}")
    return quotient


SAMPLE_RATE = 16_000
"""Audio samples a second in every feature, mono float32 in [-1, 1]."""

FPS = 25
"""Video frames a second, in datasets and in every video that is written."""

FRAMES_PER_TOKEN = 8
"""Video frames that one motion code spans (ANGIE, section 4: 96 frames are 12 codes)."""

IMAGE_SIZE = 256
"""Height and width of a frame in pixels."""

SAMPLES_PER_FRAME = _exact(SAMPLE_RATE, FPS)
SAMPLES_PER_TOKEN = SAMPLES_PER_FRAME * FRAMES_PER_TOKEN


def frames_covering(samples: int) -> int:
    """Number of frames that cover `samples` audio samples; the last may be partly silent."""
    return -(-samples // SAMPLES_PER_FRAME)


def tokens_covering(frames: int) -> int:
    """Number of motion codes that cover `frames` video frames."""
    return -(-frames // FRAMES_PER_TOKEN)
