"""How one of several fitted orders is chosen: by which criterion, what rules an order out, and how far a challenger
must lead.
"""

import math
from dataclasses import dataclass

from navfilter.foundation.arrays import ArrayLike
from navfilter.timeseries.roots import cancelling_pairs

CRITERIA = ("aic", "aicc", "bic", "hq")


def criterion(name: str, deviance: float, k: int, n: float) -> float:
    """An information criterion; smaller is better.

    Parameters
    ----------
    name : {"aic", "aicc", "bic", "hq"}
        Akaike, its small-sample form, Schwarz, Hannan and Quinn.
    deviance : float
        -2 ln L.
    k : int
        Number of parameters.
    n : float
        Number of samples.

    Examples
    --------
    >>> criterion("aic", 10.0, 2, 100), round(criterion("bic", 10.0, 2, 100), 3)
    (14.0, 19.21)
    """
    if name == "aic":
        return deviance + 2.0 * k
    if name == "aicc":
        return deviance + (2.0 * k * n / (n - k - 1) if n > k + 1 else math.inf)
    if name == "bic":
        return deviance + k * math.log(max(n, 2))
    return deviance + 2.0 * k * math.log(max(math.log(n), 1.0))


@dataclass(frozen=True)
class Choice:
    """What decides between orders.

    Attributes
    ----------
    criterion : {"aic", "aicc", "bic", "hq"}
        By which they are compared.
    lead : float
        Difference of the criterion that counts.
    hops : int
        Hops in a row at which a challenger must lead.
    level : float
        False alarms of the whiteness gate on the residuals.
    farthest : float
        No pole and zero further apart cancel, however unsure their distance.
    nearest : bool
        Only the zero nearest to a pole can cancel it.
    """

    criterion: str = "bic"
    lead: float = 6.0
    hops: int = 2
    level: float = 0.01
    farthest: float = math.inf
    nearest: bool = True

    def score(self, deviance: float, k: int, n: float) -> float:
        """The criterion of one order."""
        return criterion(self.criterion, deviance, k, n)

    def cancels(self, ar: ArrayLike, ma: ArrayLike, covariance: ArrayLike) -> bool:
        """Whether a pole and a zero are closer than two standard deviations: the pair is noise."""
        return cancelling_pairs(ar, ma, covariance, farthest=self.farthest, nearest=self.nearest) > 0


@dataclass(frozen=True)
class Challenge:
    """Which order leads over the one in use, and at how many hops in a row it has."""

    order: tuple[int, int] | None = None
    leads: int = 0

    def by(self, order: tuple[int, int]) -> "Challenge":
        """The next hop, at which this order leads."""
        return Challenge(order, self.leads + 1 if order == self.order else 1)
