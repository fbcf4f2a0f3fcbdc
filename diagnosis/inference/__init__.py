"""Whether a sound twin explains recordings, and if not, which effect does: with the error of sound twins as a distribution.

``blocks`` reduces what was seen to block means; ``members`` are sound twins of other mesh, shape, hands and material; ``absorption`` takes
from their runs what a refit of the reference would; ``covariance`` makes of the rest the distribution of a sound twin's error;
``likelihood`` weighs by it; ``scan`` asks every effect of the catalogue; ``significance`` turns misfit and scan into p-values by members
left out; ``refit`` fits the best effects in full; ``budget`` says what is left in mm and what size of each effect would have been found;
``phases`` runs them in this order.
"""

from .phases import infer

__all__ = ["infer"]
