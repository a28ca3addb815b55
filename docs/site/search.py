"""What the search of the site finds first: the name that was typed.

`index` rewrites the entries of the built index, `rank.js` asks the search of the built site.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

SHORTER = (
    0.7  # of the weight, for each letter more: of the names that begin with what was typed, the shortest is that name
)
# What is looked for, and where the first result lies.
FIRST = {
    "rotate": "#kvision.geometry.transform.rotate",
    "resize": "#kvision.geometry.transform.resize",
    "warp_affine": "#kvision.geometry.transform.warp_affine",
    "RandomAffine": "#kvision.augmentation.RandomAffine",
    "tv_tensors": "#tv_tensors-and-dicts",
    "install": "quickstart/#install",
}


def words(name: str) -> str:
    """The words of a name, `gaussian blur2d` of `gaussian_blur2d` and `Random Affine` of `RandomAffine`."""
    return re.sub(r"([a-z0-9])([A-Z][a-z])", r"\1 \2", name).replace("_", " ").strip()


def weigh(entry: dict[str, Any]) -> None:
    """Give an entry of the index the weight of its name, and the words of the name to be found by as well."""
    page, _, anchor = entry["location"].partition("#")
    if anchor.startswith("kvision."):
        name = anchor.rpartition(".")[2]
        entry["boost"] = 1000 * SHORTER ** len(name) * (1.05 if name.islower() else 1)  # functions before their modules
        if words(name) != name:
            entry["text"] = f"<span hidden>{words(name)}</span>{entry['text']}"
    elif page.startswith(("CHANGELOG", "notes/")):
        entry["boost"] = 0.1
    elif page.startswith("quickstart"):
        entry["boost"] = 2


def index(site: Path) -> None:
    """Weigh the entries of a built site, and raise unless what FIRST has comes first; Node.js runs the search."""
    path = site / "search" / "search_index.json"
    built = json.loads(path.read_text())
    for entry in built["docs"]:
        weigh(entry)
    path.write_text(json.dumps(built, separators=(",", ":")))
    if shutil.which("node") is None:
        return
    command = ["node", str(Path(__file__).with_name("rank.js")), str(site), *FIRST]
    results = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout)
    wrong = {query: found for query, found in zip(FIRST, results) if not (found or "").endswith(FIRST[query])}
    if wrong:
        raise RuntimeError(f"search: expected {FIRST} first, got {wrong}")
