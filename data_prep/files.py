"""Outputs appear whole or not at all: written beside their place, then moved there."""

import atexit
import hashlib
import os
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from data_prep.errors import BadInput


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")


def check_output(path: Path, *, force: bool = False) -> None:
    """Refuse an output path that cannot be written, before any work is done for it.

    Raises:
        BadInput: the parent is missing or not writable, or the output exists without `force`.
    """
    path = Path(path)
    parent = path.absolute().parent
    try:
        if not parent.is_dir():
            raise BadInput(f"{path}: the folder {parent} does not exist; make it first")
        if path.exists() and not force:
            raise BadInput(f"{path}: exists already; give another name or --force")
        probe = _beside(path)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise BadInput(f"{path}: cannot write there ({error.strerror})") from error


@contextmanager
def whole_file(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; it becomes `path` if the block succeeds.

    Args:
        path: the file to make.
        force: replace an existing file.

    Raises:
        BadInput: as `check_output`.
    """
    path = Path(path)
    check_output(path, force=force)
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; name a file")
    part = _beside(path)
    try:
        yield part
        if not force:
            check_output(path)  # another command may have made it meanwhile
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path, *, mark: str, force: bool = False) -> Iterator[Path]:
    """Yield a new empty folder beside `path`; it becomes `path` if the block succeeds.

    Args:
        path: the folder to make.
        mark: name of a file that every such folder holds; `force` replaces no other folder.
        force: replace an existing folder of this kind.

    Raises:
        BadInput: as `check_output`, or the folder that exists is not of this kind.
    """
    path = Path(path).resolve()
    check_output(path, force=force)
    if path.exists() and not (path / mark).is_file():
        raise BadInput(f"{path}: holds other things (no {mark}); name a new folder")
    part = _beside(path)
    part.mkdir()
    try:
        yield part
        if not force:
            check_output(path)  # another command may have made it meanwhile
        if path.exists():
            old = _beside(path)
            os.replace(path, old)
            try:
                os.replace(part, path)
            except OSError:
                os.replace(old, path)
                raise
            shutil.rmtree(old)
        else:
            os.replace(part, path)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def want_file(path: Path, what: str) -> None:
    """Refuse a path that is no file; `what` it should be is told.

    Raises:
        BadInput: missing, or a folder.
    """
    if not path.exists():
        raise BadInput(f"{path}: no such file; give the {what}")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; give the {what}")


def check_apart(output: Path, inputs: Iterable[Path]) -> None:
    """Refuse an output that is, holds or lies in the place of one of the inputs.

    Raises:
        BadInput: writing the output would replace an input.
    """
    target = Path(output).resolve()
    for given in inputs:
        source = Path(given).resolve()
        if target == source or target in source.parents:
            raise BadInput(f"{output}: would replace the input {given}; name another output")


LOCK = ".lock"


@contextmanager
def locked(folder: Path, what: Path) -> Iterator[None]:
    """Hold the lock of a folder while the block runs; it ends with the process, however that ends.

    Args:
        folder: that is worked in.
        what: to name in the message.

    Raises:
        BadInput: another process holds it.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise BadInput(f"{what}: another run is making it; wait until it has ended") from error
    try:
        yield
    finally:
        lock.release()


@contextmanager
def alone(output: Path) -> Iterator[None]:
    """Be the only one who makes an output while the block runs; it ends with the process.

    The lock is a hidden file beside the output, which is removed in the end.

    Raises:
        BadInput: another process makes it, or as `check_output`.
    """
    from filelock import FileLock, Timeout

    output = Path(output).absolute()
    check_output(output, force=True)
    lock = FileLock(output.with_name(f".{output.name}.lock"))
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        what = "another command is at work in it; wait until it has ended"
        raise BadInput(f"{output}: {what}") from error
    try:
        yield
    finally:
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def numba_cache() -> None:
    """Let numba keep what it compiles in a folder of the user's own; call before it compiles.

    Numba itself keeps it beside the code, where another user may have left what this one cannot
    read, and fails where neither that nor the home folder can be written. The folder is
    NUMBA_CACHE_DIR if that is set, else `angie/numba` in the user's cache, or a temporary one where
    that cannot be written. Where nothing can be written it is left to numba.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    try:
        cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(cache) / "angie" / "numba"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        try:
            folder = Path(tempfile.mkdtemp(prefix="angie-numba-"))
        except OSError:
            return
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:  # which read the environment when it was imported
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def sha256(path: Path) -> str:
    """Hash of a file's content as hexadecimal digits."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
