"""Files that appear complete and together, or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from equimesh.errors import InputError

__all__ = ["check_writable", "staged"]

PREFIX = ".equimesh-"


def check_writable(path: Path) -> None:
    """Raise InputError unless a file can be put at ``path``; nothing stays behind."""
    if path.is_dir():
        raise InputError(f"{path} is a folder: give the name of a file to write.")
    with _workshop(path):
        pass


@contextlib.contextmanager
def staged(targets: Sequence[Path]) -> Iterator[list[Path]]:
    """Paths to write to, beside the targets; on a clean exit all of them move into place.

    Whatever was at the targets before comes back if one of the moves fails, and an exception inside
    leaves everything as it was. Names and suffixes are those of the targets.
    """
    with contextlib.ExitStack() as stack:
        folders = [stack.enter_context(_workshop(target)) for target in targets]
        drafts = [folder / target.name for folder, target in zip(folders, targets, strict=True)]
        yield drafts
        _exchange(drafts, targets)


def _exchange(drafts: Sequence[Path], targets: Sequence[Path]) -> None:
    moved: list[tuple[Path, Path | None]] = []
    try:
        for draft, target in zip(drafts, targets, strict=True):
            kept = None
            if len(targets) > 1 and target.exists():
                kept = draft.with_name("kept-" + draft.name)
                shutil.copy2(target, kept)
            os.replace(draft, target)
            moved.append((target, kept))
    except BaseException as error:
        for target, kept in reversed(moved):
            if kept is None:
                target.unlink(missing_ok=True)
            else:
                os.replace(kept, target)
        if isinstance(error, OSError):
            raise _unwritable(targets[len(moved)], error) from error
        raise


@contextlib.contextmanager
def _workshop(target: Path) -> Iterator[Path]:
    """A hidden folder beside the target, on the same file system, removed with all it holds."""
    if not target.parent.is_dir():
        raise InputError(
            f"{target.parent} is not a folder: create it before writing {target.name}."
        )
    try:
        folder = tempfile.TemporaryDirectory(prefix=PREFIX, dir=target.parent)
    except OSError as error:
        raise _unwritable(target, error) from error
    with folder as name:
        yield Path(name)


def _unwritable(target: Path, error: OSError) -> InputError:
    reason = (error.strerror or "the system refuses").lower()
    return InputError(f"{target} cannot be written ({reason}): choose another folder.")
