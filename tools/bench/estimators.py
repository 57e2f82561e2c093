"""A sheath bent more while the loop runs: joint torque error with and without the on-line estimate.

Usage: tools/run bench/estimators [--change 0.4] [--seconds 40] [--seed 4]
The joint is written apart from the package (tests/control/following.py); it is moved from outside, and needs no bus.
"""

from __future__ import annotations

from tests.control.following import MU, THETA, Change, rms, run
from tools import command

STEP = 4.0  # s of a line


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--change", type=float, default=0.4, help="of the bending angle, as a share")
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--seed", type=int, default=4)
    arguments = parser.parse_args()
    change = Change(share=arguments.change)
    t, fixed, _ = run(change, arguments.seconds, False, arguments.seed)
    _, followed, angle = run(change, arguments.seconds, True, arguments.seed)
    print(f"bending angle {THETA:g} rad, {arguments.change:+.0%} from {change.at:g} to {change.at + change.within:g} s")
    print("time (s)   friction angle: true  estimated   RMS error (mN*m): fixed  estimated")
    begin = 0.0
    while begin + STEP <= arguments.seconds:
        end = begin + STEP
        at = int(end / arguments.seconds * t.size) - 1
        print(
            f"{begin:3.0f}-{end:3.0f}    {MU * change.theta(end):20.3f}  {angle[at]:9.3f}"
            f"   {1e3 * rms(t, fixed, begin, end):23.1f}  {1e3 * rms(t, followed, begin, end):9.1f}"
        )
        begin = end
    return 0
