"""What the headers of sound files say of their length, and where others follow in one file."""

from pathlib import Path

_UNKNOWN = 1_900_000_000
"""Bytes from which on the length in a WAV header means that it was not known when it was written:
0x7FFFFFFF less this or that, 2000000000, 0xFFFFFFFF."""


def wav_claim(path: Path) -> float:
    """Length of the sound by a RIFF file's header, in that of what is there; 1 where unknown."""
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(0)
        place = 12 if file.read(4) == b"RIFF" else end
        while place + 8 < end:
            file.seek(place)
            chunk = file.read(8)
            size = int.from_bytes(chunk[4:], "little")
            if chunk[:4] == b"data":
                return 1.0 if size >= _UNKNOWN else size / (end - place - 8)
            place += 8 + size + size % 2
    return 1.0


def chained_spans(path: Path) -> list[tuple[int, int] | None]:
    """Parts of an Ogg file in which streams follow each other, as byte spans; None for the whole.

    Each of them begins with pages that are marked as first, times start anew in it, and rate and
    channels may be others (RFC 3533, section 4).
    """
    starts = [0]
    with path.open("rb") as file:
        end = file.seek(0, 2)
        place, begun = 0, False
        while place + 27 <= end:
            file.seek(place)
            head = file.read(27)
            if head[:4] != b"OggS":
                break
            first = bool(head[5] & 2)
            if first and begun:
                starts.append(place)
            begun = not first
            place += 27 + head[26] + sum(file.read(head[26]))
    if len(starts) == 1:
        return [None]
    return list(zip(starts, [*starts[1:], end], strict=True))
