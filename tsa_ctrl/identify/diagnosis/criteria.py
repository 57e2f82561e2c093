"""Define the limits that several stages of a diagnosis share: significance, visibility, rounding and counts."""

from __future__ import annotations

# Significance. White units are standard deviations of white noise, so a sum of squares has no unit.
# Decrease of a sum of squares that noise alone can cause: 3.7 standard deviations, exceeded in one test of 5,000
BY_NOISE = 14.0
PER_COORDINATE = 7.0  # decrease of the sum of squares that a further coordinate must bring (logarithm of samples)
BEYOND = 3.0  # Student's t of a difference over about 24 blocks: 0.3 % one-sided
CERTAIN = 4.0  # Student's t with 23 degrees of freedom, or standard deviations: 0.06 % two-sided
UNDOUBTED = 60.0  # white units, a difference of two sums of squares that is certain: more than 7 standard deviations
# Largest ratio by which the scatter between blocks widens an interval or a test: 24 blocks of noise alone reach 1.4. A
# single burst could reach any value, but it is detected separately
MOST_SPREAD = 3.0

# Visibility. A reader or user does not notice less, however significant it is.
LEAST_SHARE = 0.05  # share of a mean square: 2.5 % of the RMS has no practical use
LEAST_GAIN = 0.1  # share of a mean square on held-out data: 5 % of the RMS, which is visible in a plot of both

# Rounding
ROUNDING = 1e-9  # share of a square or a gain: rounding causes smaller ones; it also keeps equal columns separable
NEGLIGIBLE = 1e-6  # share of a range, of a column or of the largest response, or rad/s: a smaller one has no effect

# Counts
BLOCKS = 24  # blocks of time for block-robust statistics
FOLDS = 6  # parts for cross-validation: a fit without one sixth of the data is hardly worse
FEWEST = 60  # score samples: two and a half in each of the blocks that all tests use
DRAWS = 200  # random trials of a distribution: they determine its deviation and the tail of its largest value to 7 %

# Motion
REVERSAL = 0.1  # s: at ordinary speed a joint reverses in less time, and a motion between two rests lasts longer
LOWEST_CUTOFF = 8.0  # Hz: joints move below 5 Hz and reverse within tens of milliseconds
# Hz, highest cut-off of a recorded velocity: five times the joint's bandwidth, so that reversals keep their time
VELOCITY_BAND = 40.0
