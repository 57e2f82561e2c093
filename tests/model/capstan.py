"""A pair of tendon-sheaths by direct integration of the capstan equation, without the package under test.

Along each tendon, from the motor end, dT/dTheta = +-sigma mu T, and the strain is T/EA. Springs in series elongate by
the local tension. The two tensions at the motor follow from the motor torque and the common path length.
"""

from __future__ import annotations

from dataclasses import dataclass

STEPS = 300  # steps of the Runge-Kutta method of fourth order per piece: 1e-12 of a tension at x = 1


@dataclass(frozen=True)
class Pair:
    """A pair of tendons in SI units. `points` are (share of the length, share of the wrap angle) from the motor end."""

    points: tuple[tuple[float, float], ...]
    x: float  # mu Theta
    pretension: float = 45.0
    motor_radius: float = 0.020
    joint_radius: float = 0.025
    axial_stiffness: float = 60e3
    length: float = 1.2
    motor_spring: float = 0.0  # m/N, of one tendon
    joint_spring: float = 0.0

    def along(self, rho: float) -> tuple[float, float]:
        """Return the tension (N) at the joint end and the elongation (m) of a tendon with 1 N at the motor."""
        tension, stretch = 1.0, self.motor_spring
        place, bent = 0.0, 0.0
        for until, share in self.points:
            width, rise = (until - place) / STEPS, (share - bent) / STEPS
            for _ in range(STEPS):  # d tension = rho tension d share; d stretch = tension l/EA d place
                k1 = rho * rise * tension
                k2 = rho * rise * (tension + 0.5 * k1)
                k3 = rho * rise * (tension + 0.5 * k2)
                k4 = rho * rise * (tension + k3)
                after = tension + (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
                # Hermite interpolation of fourth order
                middle = 0.5 * (tension + after) + rho * rise * (tension - after) / 8.0
                stretch += width * self.length / self.axial_stiffness * (tension + 4.0 * middle + after) / 6.0
                tension = after
            place, bent = until, share
        return tension, stretch + self.joint_spring * tension

    def joint_torque(self, tau_m: float, sigma: float) -> float:
        """Return tau_J (N*m) while the tendons slide in direction sigma."""
        t1, t3 = self.motor_tensions(tau_m, sigma)
        return self.joint_radius * (t3 * self.along(-sigma * self.x)[0] - t1 * self.along(sigma * self.x)[0])

    def motor_tensions(self, tau_m: float, sigma: float) -> tuple[float, float]:
        """Return (T1, T3) in N while the tendons slide in direction sigma."""
        # m: elongation of both tendons by the pretension without friction
        path = 2.0 * self.pretension * self.along(0.0)[1]
        a, b = self.along(sigma * self.x)[1], self.along(-sigma * self.x)[1]
        difference = tau_m / self.motor_radius
        t1 = (path - b * difference) / (a + b)
        return t1, t1 + difference
