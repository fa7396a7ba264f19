"""Constants of the fault rules, by module: unit in brackets, and in parentheses where each comes from.

*derived*: it follows from what is stated beside it. *measured*: on recordings. *chosen*: by judgement; these may only
become fewer (`tests/test_settings.py` counts them).
"""

from __future__ import annotations

import math

import numpy as np

from navfilter.kernels import fault_bank

#: For so long after it was refused a sensor may be wrong again [s]: it has to follow turns meanwhile. (chosen)
UNDISPUTED_S = 600.0
#: Over so long a time refused readings must agree [s]: echoes and passing iron are shorter. A velocity that is not
#: heard is lost sooner, for what accelerometers and tilt gather in seconds lets the gate in. (chosen)
SPAN_S, VELOCITY_SPAN_S = 8.0, 2.0
#: One that has been refused for so long contradicts the state, or is disputed [s]. (chosen)
REFUSED_S = 1.0
#: A sensor has been used so lately at most, if it is to speak for the state, and heard, if it is there [s]. What only
#: accelerometers carry for so long errs by more than its gauge, as the square of the time. (chosen)
RECENT_S = 5.0
#: What a sensor said counts for so long afterwards [s]: it has jumped since, or contradicts. (chosen)
COUNTS_S = 2.0
#: A sensor that others are judged by has been used for so long [s]. (chosen)
USED_S = 60.0
#: A difference has grown once it is so many times what it was at first [1]: what is refused has not jumped then, the
#: state goes away from it. (chosen)
GROWN = 3.0
#: A speed below this tells nothing of what goes with it [m/s]. (chosen)
SLOW = 0.1

# -------------------- alternative path
#: What a vehicle can do at most that does not say so [m/s]: few that swim are faster; others, twice what they do now.
#: (chosen)
MOST_SPEED, FASTER = 3.0, 2.0
#: Fixes further off than this are of another coordinate system, not of another start [m]: what is a metre north of the
#: state is no longer a metre north of them. (chosen)
REACH_M = 1e5
#: A reading speaks for so long at most [s]: after a longer silence nobody knows what the sensor would have said.
#: (chosen)
SPEAKS_S = 1.0
#: The way of the refused readings is known to this share of itself beside the heading's error [1]: what lies between
#: them, and the reading or two before the gate closed. (chosen)
PATH_SHARE = 0.1

# -------------------- bias plausibility
#: Dead reckoning may err by this share of the way made [1]: 6 deg of heading or mounting, 10 % of scale. What draws
#: fixes off in earnest is faster, or takes longer than the gate waits. (chosen)
BIAS_SHARE = 0.1
#: At rest it may err by what it may at this speed [m/s]: a constant of the velocity has no less to say then. (chosen)
USUAL_SPEED = 1.5
#: The position was pulled off by so many times the estimate at most [1]: an error that takes less than a tenth of what
#: fixes say, beside the position, has not come to be so large by that. (derived)
MOST_PULLED = 10.0

# -------------------- clocks: sensor clock
#: After so many readings that are ahead, or behind, by the same the clock of a sensor was set: one may have a wild
#: stamp. [1] (chosen)
SET = 4

# -------------------- dead reckoning compass
#: Refused fixes that come so long after each other are not of one way [s]. (chosen)
APART_S = 60.0

# -------------------- depth fault
#: A velocity that is known worse carries no height [m/s]: half a minute of it is what a glider dives. (chosen)
CARRIED_M_S = 0.1

# -------------------- fault bank
#: Each fault happens so often [1/s]: once in twenty hours. (chosen)
FAULTS_PER_S = 0.05 / 3600.0
#: Standard deviations of what may go wrong: of the velocity of what a velocity is read against [m/s], of a heading
#: or a mounting [rad], and of a bias of the unit, as a multiple of what it is at the start [1]. (chosen)
FLOW_SD, ANGLE_SD, BIAS_SDS = 0.3, math.radians(10.0), 30.0
#: The same of how a velocity sensor is described: of its lever arm [m], and its clock [s]. (chosen)
ARM_M, LATE_S = 2.0, 1.0
#: The start, or the description of a sensor, is wrong in so many missions [1]. (chosen)
DESCRIBED_WRONGLY = 0.1
#: By so much fixes may jump, or the position beside them [m]. (chosen)
JUMP_M = 100.0

# -------------------- heading fault
#: An angle is believed beyond so many standard deviations, as one hypothesis of a whole mission [1], once it is known
#: to so much [rad]: the fixes that follow do the rest, for which the filter is linear (half its square, as a share of
#: the speed, is then less than a velocity sensor errs by). (derived)
SURE, KNOWN_RAD = 5.0, 0.07
#: Root mean square distance of fixes from the way they should have made, as multiples of their sd [1]: within the
#: first they have made it, beyond the second not. (chosen)
FITS, MISSES = 2.0, 4.0
#: On a straight way fixes may as well be drawn off. Beyond this angle that is a quarter of the speed or more across
#: the way, and leaves the speed what it is [rad]: a compass beside iron is to be expected rather. (chosen)
DRAWN_RAD = math.radians(15.0)
#: What it leaves of the speed, in standard deviations [1]. (derived)
SAME_SPEED = 2.0
#: A deviation that changes with the heading by more than this, at so many of its standard deviations [1]. (chosen)
IRON_SLOPE, IRON_SURE = 0.5, 3.0

# -------------------- imu: monitor
#: What a vehicle does unseen goes on for about so long [s]. (chosen)
UNSEEN_S = 1.0
#: What contradicts compass and DVL is found so late at most [s]. (chosen)
FOUND_S = 2.0
#: The square of a second difference of white noise is so many times its variance [1]. (derived)
WHITE = 6.0
#: An error is quick whose second differences are larger than this share of its variance [1]: of one with a correlation
#: time of two hundred samples they are less. (derived)
QUICK = 0.02
#: A turn goes on for longer [s]: it pushes a vehicle whose forces nobody feels, and what it would tilt one by that felt
#: them must not pass for a tilt. (chosen)
TURN_S = 3.0

# -------------------- imu: realignment
#: A tilt with a larger sd is beyond what linearisation bears: its square turns 1 % of a velocity, or 0.02 m/s^2 of
#: gravity, into an error that no covariance has [rad]. (derived)
SURE_SD = 0.05
#: The level contradicts the state beyond this NIS, of two components: 3e-7 of the good ones do. [1] (derived)
TILT_LIMIT = 30.0
#: A force that differs from gravity by more is no level [m/s^2]: `navfilter.models.alignment` refuses it, too.
#: (chosen)
EXCESS = 1.5
#: A refused reading says what the velocity is to so much [m/s]. (chosen)
VELOCITY_SD = 0.1

# -------------------- innovation gate
#: What may be wrong with a state that all sensors contradict: roll, pitch and heading [rad]; and beside the largest
#: residual, position [m] and velocity [m/s]. (chosen)
OPEN_ATTITUDE, OPEN_MOTION = np.array([0.1, 0.1, 1.0]), np.repeat([10.0, 2.0], 3)
#: Fixes that are off by more are of another coordinate system [m], a velocity is in another unit [m/s], a depth is no
#: depth of any sea [m]. (derived)
MOST_OFF = {"position": 1e5, "velocity": 20.0, "depth": 1.2e4}
#: What together knows where the vehicle is and how it moves, and how far off it says that the state is at least [m],
#: [m/s]: a slow vehicle's wrong clock or lever arm makes less of a turn. (chosen)
MOTION = {"position": 0.0, "velocity": 2.0}
#: It contradicts the state in so long [s]: within 8 s fixes that agree with dead reckoning have had their way.
#: (chosen)
MOTION_S = 10.0
#: A sensor counts as heard for so many of its periods, too [1]. (chosen)
HEARD_PERIODS = 3.0
#: The gate of a sensor that is astray widens so many times later [1]: it was believed until it was beyond belief.
#: (chosen)
PATIENT = 5.0

# -------------------- lane selection
#: Lanes are compared so often [s]: short beside what a wrong unit does to a position. (chosen)
LANE_STEP_S = 0.25
#: Over so long a time [s]. (chosen)
WINDOW_S = 60.0
#: A component is an outlier in so many of one [1], anywhere within so many standard deviations of its sensor [1].
#: (chosen)
OUTLIERS, SPAN = 0.01, 100.0
#: Biases of a unit that is tried again are found within so long [s], and it has so many times as long to show itself
#: after each time that it has failed again [1]. (chosen)
SETTLES_S, LONGER = 15.0, 2.0
#: Another lane is taken when it has gained so much more [nat]: two sound units of one kind differ by less than 10 in a
#: minute, a frozen one loses 100 in a second. (chosen)
LANE_MARGIN = 50.0
#: The lane without an inertial unit follows whatever sensor errs, while units contradict it. So two sensors must speak
#: for it, each by what makes a fault believed [nat]. (derived)
SECOND = fault_bank.BELIEVED
#: Or a velocity goes on to contradict a unit: more has not been foretold than this [nat], and this share of all [1].
#: One that is off by a constant is found to be within seconds; a unit that is off is pulled back again and again. The
#: other lane has to follow it: of what contradicts the unit, this share may contradict that lane too [1]. Readings in
#: another unit of measurement contradict both, though the lane follows what of them is not beyond belief. What has been
#: contradicted before, any other sensor contradicts beyond the margin and that share. (chosen)
ALONE, LANE_SHARE, FOLLOWS = 900.0, 0.3, 0.1
#: Or a unit runs away from a velocity. A sensor that has jumped contradicts it by as much for as long as it does; by
#: what a unit feels wrong, it moves off further with each reading. A component contradicts beyond this NIS [1] (6e-7
#: of the good ones do). Over at least so long [s] it has moved off by more than this many standard deviations [1] of
#: what the vehicle may do unseen (`navfilter.Imu.gap_force_sd`, as a random walk of its velocity), by more than it was
#: off at first, and so many times [1] as far as from any reading to the next: noise does not lead away. (chosen)
CONTRADICTS, AWAY_S, AWAY_SD, LEADS = 25.0, 1.0, 3.0, 2.0

# -------------------- memory
#: A sensor that has been refused for so long, and then used again, was wrong itself [s]. (chosen)
SENSOR_DISPUTED_S = 3.0

# -------------------- monitor
#: A vehicle that has moved by more than so many standard deviations has moved [1]. (chosen)
STILL_SDS = 3.0

# -------------------- protection level
#: Share of the time that the truth may lie beyond a bound without any fault [1]. (chosen)
RISK = fault_bank.RISK
#: A state is confirmed by a sensor once that has been used over so long a time since the state was given or reset [s].
#: (chosen)
CONFIRMED_S = 30.0
#: Fixes to which a state was set against what was believed are right once that is so long ago [s]: a receiver that has
#: come up with a wrong place finds the right one sooner. (chosen)
FOLLOWED_S = 120.0

# -------------------- refusals
#: So many readings that agree are believed together at the earliest. [1] (chosen)
RUN_LEAST = 5
#: Share of the good series that the test of agreement over a whole run of refusals turns down. [1] (chosen)
TURNED_DOWN = 1e-4

# -------------------- sensor bias
#: A sensor that was right before has led the vehicle so far from its start [m]: one that is described wrongly is
#: refused when the vehicle first moves off. (chosen)
WAY_M = 50.0
#: The NIS of the first refused reading of a jump is beyond its limit by this factor [1]. (chosen)
AT_ONCE = 1.5
#: While a jump is looked at, a reading must fit by this much better than the gate to end that [1]: what accelerometers
#: and tilt gather meanwhile must not let in what they do not know. Not a fix: a velocity tells what the covariance of
#: a position may gather meanwhile. (chosen)
HELD = 0.25
#: What a state is led astray by a jump that a constant described badly, as a share of the jump [1]. (chosen)
AGAIN = 0.02

# -------------------- velocity fault
#: A jump of more than this share of the speed is one of the velocity itself [1]: no scale, no current does so. That the
#: sensor is back shows at more than this share of the speed at which it jumped. (chosen)
VELOCITY_SHARE = 0.5
#: A reading of less than this share of the jump says nothing of the velocity [1]: it is 0 at any. (chosen)
SAYS = 0.25
#: A reading is the same within this share of it [1]. (chosen)
VELOCITY_SAME = 0.05
#: By how much the velocity may differ as a multiple of what the reading does [1]: of another sign, by twice as much.
#: (derived)
VELOCITY_SLOPE = 2.0
#: That may come and go within about so long [s]. (chosen)
WANDERS_S = 60.0
