"""The paper's ablation tables, row by row: what stands behind a size's name, nothing for the whole model."""

TABLES = {
    "duo space features": ("bev-no-fde", "pv", "no-fde"),
    "feature divergence enhancement": ("bev-no-fde", "bev", "no-fde", ""),
    "duo space queries": ("unshared", "shared-content", ""),
    "temporal strategies": ("stacking", "attention", ""),
}


def rows(size: str) -> list[str]:
    """The presets of a size that stand in the tables, each once."""
    found = dict.fromkeys(row for table in TABLES.values() for row in table)
    return [f"{size}-{row}" if row else size for row in found]
