"""Learning sensors' errors under way: what is listened to, the likelihood of one axis, the learner, and when it is
asked.
"""
