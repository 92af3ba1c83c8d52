"""The name of the file that holds the masks of a dive, beside its frames."""

from pathlib import Path

MASK_FILE = "tokt-mask.json"


def mask_file(mission: Path) -> Path:
    """Return the file of a folder's masks, or of a video's."""
    return mission / MASK_FILE if mission.is_dir() else Path(f"{mission}.{MASK_FILE}")
