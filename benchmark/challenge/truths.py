"""One case as it is scored: its label beside what was answered, and how large what was concealed truly is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...datasets.concealed.world import FPS
from ...datasets.synthetic.simulate import GRAVITY
from ...diagnosis.effects.registry import effects
from ...diagnosis.verdict import NONE, OTHER
from ...physics.catalogue import terms
from .schema import NAMED

__all__ = ["Row", "amplitude", "physical"]


@dataclass(frozen=True)
class Row:
    """One case.

    ceiling  the answer of who was told, or None
    floor    what a twin of such a sound body is off by [m]
    """

    name: str
    label: Mapping
    answer: Mapping
    ceiling: Mapping | None = None
    floor: float = float("nan")

    @property
    def kind(self) -> str:
        return self.label["kind"]

    @property
    def parts(self) -> list[Mapping]:
        """The labels of what was concealed, one or two."""
        return list(self.label.get("parts") or ([] if self.kind == "control" else [self.label]))

    @property
    def truths(self) -> set[str]:
        """What a right answer names: "adequate", "unknown" for what is in no catalogue, or the effects."""
        if self.kind == "control":
            return {NONE}
        return {OTHER} if self.kind == "outside" else {part["effect"] for part in self.parts}

    @property
    def truth(self) -> str:
        return "+".join(sorted(self.truths))

    @property
    def verdict(self) -> str:
        return self.answer["verdict"]

    @property
    def named(self) -> bool:
        return self.verdict in NAMED

    @property
    def alarm(self) -> bool:
        """Whether it says that something is not as the twin has it."""
        return self.named or self.verdict == OTHER

    @property
    def said(self) -> str:
        """The name, or the verdict where there is none."""
        return self.answer["effect"] if self.named else self.verdict

    @property
    def first(self) -> bool:
        """Whether the first name is right."""
        return self.named and self.answer["effect"] in self.truths

    @property
    def of_two(self) -> bool:
        """Whether the name is right, or one of the two between which it leaves the choice."""
        return self.named and bool(self.truths & {self.answer["effect"], *self.answer["alternatives"][:1]})

    @property
    def probabilities(self) -> dict[str, float]:
        """Largest first; a refusal without any gives nothing away."""
        return dict(sorted((self.answer.get("probabilities") or {NONE: 1.0}).items(), key=lambda item: -item[1]))

    @property
    def suspicion(self) -> float:
        """Probability that something is missing."""
        return 1 - self.probabilities.get(NONE, 0.0)

    @property
    def conviction(self) -> float:
        """Probability of the likeliest name in the catalogue."""
        return max((p for n, p in self.probabilities.items() if n not in (NONE, OTHER)), default=0.0)

    @property
    def likeliest(self) -> tuple[str, float]:
        return next(iter(self.probabilities.items()))

    @property
    def rank(self) -> float:
        """Place of a right name among the names by probability, from 1; infinite where it has none."""
        names = [n for n in self.probabilities if n not in (NONE, OTHER)]
        return min((names.index(n) + 1 for n in self.truths if n in names), default=np.inf)

    @property
    def ratio(self) -> float:
        """By how much what was concealed moves the points, over what a twin of such a sound body is off by."""
        return self.label["displacement"] / self.floor

    @property
    def concealed(self) -> Mapping | None:
        """The label of what was named rightly, or None."""
        return next((part for part in self.parts if self.first and part["effect"] == self.answer["effect"]), None)

    @property
    def foreseen(self) -> float:
        """The true size over the smallest that the answer says would have stood out in this recording; NaN where either is not known."""
        if len(self.parts) != 1:
            return float("nan")
        least = (self.answer.get("detectable") or {}).get(self.label["effect"])
        true, _ = self.true_amplitude(self.parts[0])
        return true / least if least else float("nan")

    def true_amplitude(self, part: Mapping) -> tuple[float, str]:
        """Its size in the twin's unit: from the label where physics says it, else as fitted by who was told ("oracle"); NaN and "" else."""
        value = physical(part, self.label)
        if np.isfinite(value):
            return value, "physics"
        told = amplitude(part["effect"], (self.ceiling or {}).get("parameters") or {})
        return (told, "oracle") if np.isfinite(told) and told > 0 else (float("nan"), "")


def amplitude(effect: str, parameters: Mapping[str, Mapping]) -> float:
    """The size of an effect from an answer's parameters: the length of the vector of its amplitudes; NaN where they are not there."""
    told = [(each.name, each.amplitudes) for each in (term.stands_for() for term in terms().values() if term.effect)]
    told += [(each.name, tuple(amount.name for amount in each.amounts)) for each in effects()]  # those without a term of their own too
    for names in (names for name, names in told if name == effect and all(n in parameters for n in names)):
        return float(np.linalg.norm([parameters[n]["value"] for n in names]))
    return float("nan")


def physical(part: Mapping, label: Mapping) -> float:
    """The true size of an effect in the unit of its term's amplitudes where label and term speak of the same quantity, else NaN."""
    given, body = part["parameters"], label.get("body", {})
    per_mass = body["area_m2"] / body["mass_kg"] if {"area_m2", "mass_kg"} <= set(body) else float("nan")  # m^2/kg
    laws = {
        "quadratic_drag": lambda: given["coefficient_kg_m3"] * per_mass,  # F = c A v^2 on a mass m: c A / m [1/m]
        "wind": lambda: given["coefficient_kg_m3"] * per_mass * np.square(given["velocity_m_s"]).sum(),  # at rest, c A w^2 / m [m/s^2]
        "gravity_tilt": lambda: np.linalg.norm(np.subtract(given["gravity_m_s2"], [0.0, 0.0, GRAVITY])),  # z down [m/s^2]
        "strain_stiffening": lambda: given["factor"],  # stress E e (1 + b e^2)
        "viscoelastic": lambda: given["ratio"],  # E (1 + r exp(-t / tau))
        "creep": lambda: 1 / given["time_s"],  # stress falls as exp(-t / tau), springs' as exp(-r t)
        "rest_shape": lambda: abs(np.log1p(given["strain"])),
        "added_mass": lambda: given["added_g"] / (1000 * body["mass_kg"] - given["added_g"]),
        "controller_delay": lambda: given["frames"] / FPS,
        "friction_law": lambda: given["static"] - given["kinetic"],
        "grip_points": lambda: np.linalg.norm(given["shift_m"]),
    }
    try:
        return float(laws[part["effect"]]())
    except KeyError:
        return float("nan")
