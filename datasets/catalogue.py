"""The published PhysTwin recordings: 22 cases, 22 transfer pairs and the numbers that the paper reports for them."""

from __future__ import annotations

from dataclasses import dataclass

from .scenario import TransferPair

__all__ = ["CASES", "CITATION", "CITED", "PAIRS", "PUBLISHED", "Case", "cited_from", "self_collides"]

CITATION = (
    "H. Jiang, H.-Y. Hsu, K. Zhang, H.-N. Yu, S. Wang, Y. Li. "
    "PhysTwin: Physics-Informed Reconstruction and Simulation of Deformable Objects from Videos. ICCV 2025."
)


@dataclass(frozen=True)
class Case:
    """One published recording.

    category    what the authors ask their text-driven detector for
    shape_prior whether surface and interior points were added from a generated mesh
    config      "real" (no self-collision) or "cloth" (self-collision)
    object      the physical thing; inferred from case names and pairs, the authors publish no such list
    """

    name: str
    category: str
    shape_prior: bool
    config: str
    object: str


_TABLE = """
rope_double_hand     twine   yes real  rope
single_lift_rope     twine   yes real  rope
single_push_rope     twine   yes real  rope
single_push_rope_1   twine   yes real  rope_1
single_push_rope_4   twine   yes real  rope_4
double_stretch_zebra toy     yes real  zebra
double_lift_zebra    toy     yes real  zebra
single_lift_zebra    toy     yes real  zebra
double_stretch_sloth sloth   yes real  sloth
double_lift_sloth    sloth   yes real  sloth
single_lift_sloth    sloth   yes real  sloth
single_push_sloth    sloth   yes real  sloth
single_lift_dinosor  dinosor yes real  dinosor
weird_package        package no  cloth package
single_lift_cloth    cloth   no  cloth cloth
single_lift_cloth_1  cloth   no  cloth cloth_1
single_lift_cloth_3  cloth   no  cloth cloth_3
single_lift_cloth_4  cloth   no  cloth cloth_4
double_lift_cloth_1  cloth   no  cloth cloth_1
double_lift_cloth_3  cloth   no  cloth cloth_3
single_clift_cloth_1 cloth   no  cloth cloth_1
single_clift_cloth_3 cloth   no  cloth cloth_3
"""

CASES = {
    name: Case(name, category, prior == "yes", config, thing)
    for name, category, prior, config, thing in (line.split() for line in _TABLE.strip().splitlines())
}

_UNORDERED_PAIRS = (
    ("rope_double_hand", "single_push_rope"),
    ("rope_double_hand", "single_lift_rope"),
    ("single_push_rope", "single_lift_rope"),
    ("double_lift_sloth", "double_stretch_sloth"),
    ("double_lift_zebra", "double_stretch_zebra"),
    ("single_lift_cloth_1", "double_lift_cloth_1"),
    ("single_lift_cloth_1", "single_clift_cloth_1"),
    ("double_lift_cloth_1", "single_clift_cloth_1"),
    ("single_lift_cloth_3", "double_lift_cloth_3"),
    ("single_lift_cloth_3", "single_clift_cloth_3"),
    ("double_lift_cloth_3", "single_clift_cloth_3"),
)

PAIRS = tuple(TransferPair((source,), target) for a, b in _UNORDERED_PAIRS for source, target in ((a, b), (b, a)))


def self_collides(name: str) -> bool:
    """Whether the published code would switch self-collision on for a case: it looks for two words in the case name."""
    return "cloth" in name or "package" in name


# Means over all cases as the paper prints them: Chamfer [m], track error [m], IoU [fraction], PSNR [dB], SSIM, LPIPS.
# Spring-Gaus is averaged over the cases on which it succeeded only.
_METRICS = ("chamfer", "track_error", "iou", "psnr", "ssim", "lpips")
_NUMBERS = {
    ("resimulation", "spring-gaus"): (0.041, 0.050, 0.576, 23.445, 0.928, 0.102),
    ("resimulation", "gs-dynamics"): (0.014, 0.022, 0.721, 26.260, 0.940, 0.052),
    ("resimulation", "phystwin"): (0.005, 0.009, 0.844, 28.214, 0.945, 0.034),
    ("resimulation", "phystwin-zero"): (0.007, 0.012, 0.802, 27.409, 0.943, 0.039),
    ("resimulation", "phystwin-first"): (0.008, 0.012, 0.827, 27.913, 0.944, 0.037),
    ("prediction", "spring-gaus"): (0.062, 0.094, 0.464, 22.488, 0.924, 0.113),
    ("prediction", "gs-dynamics"): (0.041, 0.070, 0.498, 22.540, 0.924, 0.097),
    ("prediction", "phystwin"): (0.012, 0.022, 0.725, 25.617, 0.941, 0.055),
    ("prediction", "phystwin-zero"): (0.014, 0.025, 0.692, 25.008, 0.938, 0.061),
    ("prediction", "phystwin-first"): (0.019, 0.034, 0.657, 24.572, 0.936, 0.067),
    ("transfer", "gs-dynamics"): (0.029, 0.038, 0.634, 25.053, 0.934, 0.067),
    ("transfer", "phystwin"): (0.013, 0.018, 0.7218, 26.199, 0.938, 0.047),
}
PUBLISHED = {(*key, metric): value for key, values in _NUMBERS.items() for metric, value in zip(_METRICS, values, strict=True)}

# Later work on the same 22 cases, cited and not run here: Chamfer and track error [m] of the future prediction, and where they are from.
# The first four are as published or as BayesianPhysTwin lists them (MatPhys learns from a single view; of PhySPRING level 0, the finest);
# the last two are the released twins that it scored anew, with each point's last residual of training carried on, and as they are.
_RESCORED = "IPS-Stuttgart, BayesianPhysTwin, github.com/IPS-Stuttgart/BayesianPhysTwin"
_LATER = {
    "matphys": (0.0080, 0.0150, "Y. Yang et al., MatPhys, arXiv:2605.19386"),
    "neuspring": (0.0087, 0.0175, "Q. Xu et al., NeuSpring, arXiv:2511.08310"),
    "physpring": (0.0096, 0.0197, "Y. Jing et al., PhySPRING, arXiv:2605.07687"),
    "physworld": (0.0100, 0.0210, "Y. Yang et al., PhysWorld, arXiv:2510.21447"),
    "phystwin + last residual": (0.010185, 0.019156, _RESCORED),
    "phystwin, released twins": (0.011579, 0.022019, _RESCORED),
}
CITED = {
    ("prediction", f"{name} (cited, not run here)", metric): value
    for name, (*values, _) in _LATER.items()
    for metric, value in zip(_METRICS, values, strict=False)  # fewer metrics
}


def cited_from() -> str:
    """Where the figures of ``CITED`` are from, and with what care to read them."""
    sources: dict[str, list[str]] = {}
    for name, (*_, source) in _LATER.items():
        sources.setdefault(source, []).append(name)
    listed = "; ".join(f"{', '.join(names)}: {source}" for source, names in sources.items())
    return f"Cited, not run here, by protocols that may differ from the paper's and from each other: {listed}."
