"""Speaks phrases with libespeak-ng in a process of its own, so that every run starts afresh.

Run as `python -m data_prep.phantom.espeak_library`: a request as JSON on standard input, an npz on
standard output. The library draws its noise from a state that it keeps, so only a fresh process
says the same twice.
"""

import ctypes
import io
import json
import sys

import numpy as np

_NAMES = ("libespeak-ng.so.1", "libespeak-ng.so", "libespeak-ng.1.dylib", "libespeak-ng.dll")
_SYNCHRONOUS, _PHONEME_EVENTS, _UTF8 = 2, 1, 1
_RATE, _PITCH, _RANGE = 1, 3, 4
_WORD, _PHONEME = 1, 7


class _Name(ctypes.Union):
    _fields_ = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]


class _Event(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _Name),
    ]


_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
)


def load() -> ctypes.CDLL | None:
    """The library, None when it is not installed."""
    for name in _NAMES:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def speak(request: dict) -> dict[str, np.ndarray]:
    """Say phrases.

    Args:
        request: `voice`, `pitch`, `range` (0 to 99) and `phrases`, pairs of a text and its words a
            minute.

    Returns:
        `rate`; for each phrase i `samples_i` (N,) int16, `word_at_i` and `word_letter_i` (n,)
        sample and letter (from 1) of the beginning of words, `phone_at_i` (m,) and `phone_i` (m,)
        samples and names of phonemes.
    """
    library = load()
    if library is None:
        raise OSError("libespeak-ng is not installed")
    rate = library.espeak_Initialize(_SYNCHRONOUS, 200, None, _PHONEME_EVENTS)
    if rate <= 0:
        raise OSError("libespeak-ng does not start: its data is missing")
    if library.espeak_SetVoiceByName(request["voice"].encode()) != 0:
        raise OSError(f"libespeak-ng has no voice {request['voice']}")
    sound: list[np.ndarray] = []
    words: list[tuple[int, int]] = []
    phones: list[tuple[int, bytes]] = []

    def take(wave, count, events) -> int:  # type: ignore[no-untyped-def]
        if count > 0:
            sound.append(np.ctypeslib.as_array(wave, (count,)).copy())
        index = 0
        while events[index].type:
            event = events[index]
            if event.type == _WORD:
                words.append((event.sample, event.text_position))
            elif event.type == _PHONEME:
                phones.append((event.sample, event.id.string))
            index += 1
        return 0

    keep = _CALLBACK(take)
    library.espeak_SetSynthCallback(keep)
    library.espeak_SetParameter(_PITCH, request["pitch"], 0)
    library.espeak_SetParameter(_RANGE, request["range"], 0)
    out = {"rate": np.array(rate)}
    for index, (text, pace) in enumerate(request["phrases"]):
        for found in (sound, words, phones):
            found.clear()
        library.espeak_SetParameter(_RATE, pace, 0)
        letters = text.encode() + b"\0"
        library.espeak_Synth(letters, len(letters), 0, 1, 0, _UTF8, None, None)
        library.espeak_Synchronize()
        out[f"samples_{index}"] = np.concatenate([*sound, np.zeros(0, np.int16)])
        out[f"word_at_{index}"] = np.array([at for at, _ in words], np.int64)
        out[f"word_letter_{index}"] = np.array([letter for _, letter in words], np.int64)
        out[f"phone_at_{index}"] = np.array([at for at, _ in phones], np.int64)
        out[f"phone_{index}"] = np.array([name.decode() for _, name in phones], "U8")
    return out


def main() -> None:
    """Answer one request."""
    answer = io.BytesIO()
    np.savez(answer, **speak(json.load(sys.stdin)))  # type: ignore[arg-type]
    sys.stdout.buffer.write(answer.getvalue())


if __name__ == "__main__":
    main()
