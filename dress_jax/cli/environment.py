"""Process-wide settings of a command: double precision, compiled-program cache, quiet XLA."""

import os
from pathlib import Path

CACHE_VARIABLE = "DRESS_JAX_CACHE_DIR"
NO_CACHE = "off"
_SHORTEST_CACHED = 0.2  # seconds of compilation; loading a program takes about a tenth


def default_cache_folder() -> Path:
    """`dress_jax/programs` in the user's cache folder (XDG_CACHE_HOME, or ~/.cache)."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification: relative paths are to be ignored.
    base = Path(root) if os.path.isabs(root) else Path("~/.cache").expanduser()
    return base / "dress_jax" / "programs"


def prepare(cache: str | None = None) -> str | None:
    """Set the process up; the first call imports jax.

    Args:
        cache: folder for compiled programs, "off" for none, None for the default.

    Returns:
        A warning for the user, or None: without a cache everything works, only slower.
    """
    # XLA complains at length about every program that it loads from the cache.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    jax.config.update("jax_enable_x64", True)
    if cache == NO_CACHE:
        return None
    folder = Path(cache) if cache else default_cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        return (
            f"{folder} cannot be written to, so programs are compiled anew every time; "
            f"give another folder with --cache-dir or {CACHE_VARIABLE}"
        )
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", _SHORTEST_CACHED)
    return None
