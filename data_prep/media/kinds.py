"""What a file is by its first bytes, where its name says something else."""

from pathlib import Path

_HEIF = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_SIGNATURES = (
    (b"version https://git-lfs", "a Git LFS pointer, not the file itself; run: git lfs pull"),
    (b"%PDF", "a PDF document; export the picture or the sound from it"),
    (b"\xff\x0a", "a JPEG XL picture; save it as JPEG or PNG"),
    (b"\0\0\0\x0cJXL ", "a JPEG XL picture; save it as JPEG or PNG"),
    (b"MThd", "a MIDI file, which holds notes and no sound; export it as sound"),
    (b"PK\x03\x04", "a ZIP archive; unpack it, and name the file inside"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive; unpack it, and name the file inside"),
    (b"Rar!", "a RAR archive; unpack it, and name the file inside"),
    (b"\x1f\x8b", "a gzip archive; unpack it, and name the file inside"),
    (b"FUJIFILMCCD-RAW", "a camera's raw picture; develop it to JPEG or PNG"),
    (b"\x89PNG", "a picture"),
    (b"\xff\xd8\xff", "a picture"),
    (b"ID3", "a recording"),
    (b"fLaC", "a recording"),
    (b"OggS", "a recording"),
    (b"\x1aE\xdf\xa3", "a video or recording"),
)


def kind_of(path: Path) -> str:
    """What a file is, as "a web page; ..." with what to do about it; "" where it is not known."""
    try:
        with Path(path).open("rb") as file:
            head = file.read(1024)
    except OSError:
        return ""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype html", b"<html", b"<head", b"<body")):
        return "a web page, not the file that was to be downloaded; download that"
    if text.startswith((b"<svg", b"<?xml")):
        drawing = b"<svg" in text
        return "an SVG drawing; export it as PNG" if drawing else "an XML document"
    if head[4:8] == b"ftyp":
        brand = head[8:12]
        if brand in _HEIF:
            return HEIC
        if brand in (b"avif", b"avis"):
            return "an AVIF picture; save it as JPEG or PNG"
        return "a camera's raw picture; develop it" if brand == b"crx " else "a video or recording"
    if head[:4] == b"RIFF":
        return {b"WAVE": "a recording", b"AVI ": "a video"}.get(head[8:12], "")
    return next((kind for start, kind in _SIGNATURES if head.startswith(start)), "")


HEIC = "a HEIC picture; pip install pillow-heif, or save it as JPEG"
