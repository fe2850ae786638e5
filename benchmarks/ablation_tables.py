"""The paper's ablation tables: their rows and the scores that the paper reports."""

# mAP and NDS on nuScenes (paper, "Ablation Studies"), by table and row. A row is the suffix of a preset's name; the
# empty suffix is the full model. The first three tables appear to use single frames.
ABLATION_TABLES: dict[str, dict[str, tuple[float, float]]] = {
    "duo space features": {"bev-no-fde": (0.203, 0.264), "pv": (0.212, 0.261), "no-fde": (0.216, 0.288)},
    "feature divergence enhancement": {
        "bev-no-fde": (0.203, 0.264),
        "bev": (0.210, 0.260),
        "no-fde": (0.216, 0.288),
        "": (0.229, 0.294),
    },
    "duo space queries": {"unshared": (0.202, 0.252), "shared-content": (0.225, 0.290), "": (0.229, 0.294)},
    "temporal strategies": {"stacking": (0.236, 0.337), "attention": (0.243, 0.340), "": (0.266, 0.385)},
}
ABLATION_ROWS = tuple(dict.fromkeys(row for rows in ABLATION_TABLES.values() for row in rows))  # each row once


def ablation_presets(size: str) -> list[str]:
    """The names of the presets of all rows at a size: "tiny", "tiny-pv", ..."""
    return [f"{size}-{row}" if row else size for row in ABLATION_ROWS]
