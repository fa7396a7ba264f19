"""Learning a sensor's error under way: the likelihood of one channel, and the learner that follows it from hop to hop."""

from navfilter.learning.channel import ChannelFit, Drift, fit_channel
from navfilter.learning.learner import Learner

__all__ = ["ChannelFit", "Drift", "Learner", "fit_channel"]
