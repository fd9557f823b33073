"""A folder of results that belong together: all of them appear in it, or none."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from valvesim.errors import InputError


@contextlib.contextmanager
def all_or_nothing(folder: Path, names: Sequence[str]) -> Iterator[Path]:
    """A folder beside `folder` to write in; at the end its files move there, and no others of `names` stay there.

    Whatever happens before, `folder` is as it was, and no folder is left that was made for it. Raises InputError where
    that cannot be.
    """
    from valvesim.io import reason

    folder = folder.absolute()
    missing = [parent for parent in folder.parents if not parent.exists()]
    try:
        if folder.exists() and not folder.is_dir():
            raise FileExistsError("it is a file")
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be written ({reason(error)})", file=folder) from None
    try:
        yield temporary
        try:
            folder.mkdir(exist_ok=True)
            written = {path.name for path in temporary.iterdir()}
            for name in sorted(written):
                os.replace(temporary / name, folder / name)
            for name in set(names) - written:
                (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"cannot be written ({reason(error)})", file=folder) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for parent in missing:  # innermost first; only empty ones go
            with contextlib.suppress(OSError):
                parent.rmdir()
